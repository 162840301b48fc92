"""Symplectic Euler at the largest stable step."""
