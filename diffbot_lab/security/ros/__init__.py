"""The rights that running nodes use."""
