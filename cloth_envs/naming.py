"""Errors for unknown names: list the choices and name the nearest match."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


def unknown_name(what: str, name: object, choices: Iterable[str]) -> ValueError:
    """A ``ValueError`` that says what to write instead of ``name``."""
    known = sorted(choices)
    folded = {choice.lower(): choice for choice in known}
    near = get_close_matches(str(name).lower(), folded, n=1, cutoff=0.4)
    hint = f" Did you mean {folded[near[0]]!r}?" if near else ""
    return ValueError(f"unknown {what} {name!r}.{hint} Choose one of {', '.join(map(repr, known))}.")
