"""How networks are trained: a frozen recipe each."""
