"""The physics-embedded CNN cell."""
