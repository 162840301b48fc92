"""Error against time, every method."""
