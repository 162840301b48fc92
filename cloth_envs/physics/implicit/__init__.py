"""Implicit Euler and SDIRK2 to a residual."""
