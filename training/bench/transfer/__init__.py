"""Policies trained on surrogates, scored on the solver."""
