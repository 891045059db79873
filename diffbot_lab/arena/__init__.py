"""Benchmarks of the law against its peers and of the filter's variants, with targets, tables and figures."""
