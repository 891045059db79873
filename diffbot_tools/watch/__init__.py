"""``diffbot watch``: the page of a live robot, fed by a node that subscribes and sends goals."""
