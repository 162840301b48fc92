"""The physics-embedded cell of Zhao 2024: its data, ways to its numbers, and what the shipped ones were fitted by."""
