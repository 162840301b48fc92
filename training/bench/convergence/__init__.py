"""Orders of convergence and the chaos floor."""
