"""Bounds from below: noise that is chosen against the law, and random noise against a certificate."""
