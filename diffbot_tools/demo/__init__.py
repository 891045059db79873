"""The demonstration: the whole graph over DDS, three goals, a bag and a report."""
