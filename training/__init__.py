"""Data generation, training and benchmarks; nothing imports this but the command line."""
