"""A page to look at a robot: live (``diffbot watch``) and of a recorded bag (``diffbot report``)."""
