"""The law as published, and the re-approach that only its presets have."""
