"""``minicloth bench agents``."""
