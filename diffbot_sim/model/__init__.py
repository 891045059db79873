"""The plant, its sensors and their counter-based noise."""
