"""Public data sets of real robots to bags: MR.CLAM and the Labyrinth data set."""
