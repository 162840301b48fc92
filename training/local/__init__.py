"""Local upscalers: windows of miniature runs beside the truth, and their training."""
