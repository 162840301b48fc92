"""What the ``minicloth`` commands do; ``cloth_envs.cli`` parses their arguments."""
