"""Publishers, parameters and pacing of the node ``plant``."""
