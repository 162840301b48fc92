"""``training``, which lies beside ``cloth_envs`` in a checkout and in no wheel: the one place that finds it."""

from __future__ import annotations

import sys
from importlib import import_module
from typing import Any

from cloth_envs.extras import CHECKOUT, in_checkout


def load(name: str) -> Any:
    """What ``"module:attribute"`` of ``training`` names.

    Raises:
        ImportError: there is no checkout here, or a package of somebody else is called ``training`` too; says what
            to do.
    """
    module, attribute = name.split(":")
    if not in_checkout():
        raise ImportError(
            "this command needs a checkout, since the folder training/ is not part of the installed package: "
            'git clone the repository of MiniCloth and run pip install -e ".[train]" in it'
        )
    if str(CHECKOUT) not in sys.path:
        sys.path.insert(0, str(CHECKOUT))
    found = import_module("training").__file__
    if found != str(CHECKOUT / "training" / "__init__.py"):
        raise ImportError(
            f"another package is called training ({found}) and was imported before the one of {CHECKOUT}: "
            f"start minicloth in {CHECKOUT}, or take the other out of PYTHONPATH"
        )
    return getattr(import_module(module), attribute)
