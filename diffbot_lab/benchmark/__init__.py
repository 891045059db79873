"""The switching law and its peers under equal conditions, their tuning, and docking beside Nav2's docking server."""
