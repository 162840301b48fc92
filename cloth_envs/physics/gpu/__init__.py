"""Sheets on a graphics card: one block of threads steps one cloth."""
