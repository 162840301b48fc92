"""Optional packages: the line that installs them, for the errors of whoever needs one."""

from __future__ import annotations

from pathlib import Path

CHECKOUT = Path(__file__).resolve().parents[1]  # where this package lies in a checkout; site-packages elsewhere


def in_checkout() -> bool:
    """Whether the package is used from a checkout of its repository."""
    return (CHECKOUT / "pyproject.toml").is_file() and (CHECKOUT / "training" / "__init__.py").is_file()


def install(extra: str) -> str:
    """The command that brings the optional dependencies ``extra``.

    The package is on no index: a checkout is installed again; an installed wheel satisfies pip, which adds the extra's.
    """
    return f'pip install -e ".[{extra}]" in {CHECKOUT}' if in_checkout() else f'pip install "minicloth[{extra}]"'
