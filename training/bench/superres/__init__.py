"""``minicloth bench super-resolution``: super-resolved cloth beside the fine simulation."""
