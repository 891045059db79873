"""The law against its peers: cases, entries, tuning, effects, and in folders the reports, the bounds and the movie."""
