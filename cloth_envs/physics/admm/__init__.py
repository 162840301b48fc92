"""P-ADMM."""
