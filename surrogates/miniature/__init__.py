"""Coarse physics and an upscaler."""
