"""Compare the switching law with its peers under equal conditions, tune the laws, and compare docking with Nav2."""
