"""Benchmarks: each prints tables and writes tidy rows."""
