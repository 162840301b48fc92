"""Published networks of upscaling: pairs out of generated trajectories, and their training."""
