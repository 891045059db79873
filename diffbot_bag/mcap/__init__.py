"""The MCAP format: records, chunks, files, and their repair."""
