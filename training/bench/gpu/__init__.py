"""Thousands of environments on a graphics card beside the processor's cores."""
