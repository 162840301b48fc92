"""Solvers and laws."""
