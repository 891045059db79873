"""Docking, beside Nav2's docking server."""
