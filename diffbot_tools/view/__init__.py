"""A page that shows a robot: live (``diffbot watch``) or from a bag (``diffbot report``)."""
