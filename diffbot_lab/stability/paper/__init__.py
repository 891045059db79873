"""Certificate of laws (13) and (17) near the goal: images, ranks, file and check."""
