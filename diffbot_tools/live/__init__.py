"""A look at a running robot: each input and output in one line, with what to do."""
