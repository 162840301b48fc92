"""The correction of the coarse dynamics: decimated truth, and its training."""
