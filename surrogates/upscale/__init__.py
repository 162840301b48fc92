"""From the coarse cloth to the fine one."""
