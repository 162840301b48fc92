"""``minicloth bench synchronised``: fine cloths that are pulled along with coarse ones."""
