"""Whole episodes beside the reference's, each statistic apart."""
