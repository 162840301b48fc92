"""Time of the kernels and of the environments."""
