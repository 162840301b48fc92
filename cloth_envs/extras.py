"""Optional packages: the line that installs them, for the errors of whoever needs one."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, requires
from pathlib import Path

CHECKOUT = Path(__file__).resolve().parents[1]  # where this package lies in a checkout; site-packages elsewhere


def in_checkout() -> bool:
    """Whether the package is used from a checkout of its repository."""
    return (CHECKOUT / "pyproject.toml").is_file() and (CHECKOUT / "training" / "__init__.py").is_file()


def install(extra: str) -> str:
    """The command that brings the optional dependencies ``extra``.

    The package is on no index: in a checkout it is installed from there, elsewhere its wheel has told what it needs.
    """
    if in_checkout():
        return f'pip install -e ".[{extra}]" in {CHECKOUT}'
    try:
        needs = requires("minicloth") or []
    except PackageNotFoundError:
        needs = []
    parts = [need.split(";")[0].strip() for need in needs if f'extra == "{extra}"' in need.replace("'", '"')]
    return "pip install " + " ".join(f'"{part}"' for part in parts or [f"minicloth[{extra}]"])
