"""Velocity Verlet at the largest stable step."""
