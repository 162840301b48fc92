"""The net of particles of Zhao 2024."""
