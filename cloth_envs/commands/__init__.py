"""What the ``minicloth`` commands do; ``cloth_envs.commands.cli`` parses their arguments."""
