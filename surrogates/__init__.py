"""Learned backends."""
