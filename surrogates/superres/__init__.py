"""Fine wrinkles on a coarse cloth: pairs of cloths that move together (Chen et al. 2020)."""
