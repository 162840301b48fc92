"""Every table of the papers beside ours."""
