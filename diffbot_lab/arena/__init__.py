"""The law against its peers: cases, entries, runs, tuning, and in folders the reports and the docking study."""
