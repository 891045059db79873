"""Factors between units."""

NS_PER_S = 1_000_000_000
"""nanoseconds in a second, exact"""
S_PER_NS = 1e-9
"""seconds in a nanosecond"""
