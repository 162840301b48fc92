"""Other engines on the same scenes."""
