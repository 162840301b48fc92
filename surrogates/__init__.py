"""Learned backends; none yet."""
