"""Pairs of cloths that move together, to learn fine wrinkles from (Chen et al. 2020)."""
