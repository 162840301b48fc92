"""Error against twice the mesh."""
