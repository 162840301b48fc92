"""What was meant by options that a command with ``--backend`` and ``--material`` does not have."""

import json
from argparse import Namespace
from typing import Any

from cloth_envs.backend import parse_backend
from cloth_envs.material import MEANT, PROPERTIES
from cloth_envs.places import as_option, find_home


def read_value(text: str | None) -> Any:
    """JSON as what it says, other text as it is, nothing as True."""
    if text is None:
        return True
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        return text


def physics_or_material(option: str, text: str | None, given: Namespace) -> str | None:
    """How an option of the physics or a material's property is written, beside what was ``given``; None for others."""
    word, value = option.lstrip("-").replace("-", "_"), read_value(text)
    texts = [given.backend] if "backend" in given else given.backends
    for backend, options in [parse_backend(text.partition("@")[0]) for text in texts[:1]] or [("reference", {})]:
        home = find_home(word, value, backend, options)
        if home is not None:
            return as_option(*home)
    name = MEANT.get(word, word)
    return f"--material '{json.dumps({name: value})}'" if name in PROPERTIES else None
