"""Names: what they stand for, and errors for unknown ones that list the choices and name the nearest match."""

import re
from collections.abc import Iterable
from difflib import get_close_matches
from importlib import import_module
from typing import Any

from cloth_envs.extras import EXTRAS, missing

REVISED = "-v1"  # after a scene's name: its task of version 1


def unknown_name(what: str, name: object, choices: Iterable[str], *, meant: str | None = None) -> ValueError:
    """A ``ValueError`` that says what to write instead of ``name``: ``meant``, or the choice that is most like it."""
    known = sorted(set(choices))
    near = meant if meant in known else nearest(name, known)
    hint = f" Did you mean {near!r}?" if near else ""
    return ValueError(f"unknown {what} {name!r}.{hint} Choose one of {', '.join(map(repr, known))}.")


def nearest(name: object, choices: Iterable[str]) -> str | None:
    """The choice that is spelled much like ``name``, in any case, or has it among its words; None if none is."""
    folded, text = {choice.lower().lstrip("-"): choice for choice in choices}, str(name).lower().lstrip("-")
    near = get_close_matches(text, folded, n=1) or [choice for choice in folded if text in re.split(r"[\W_]+", choice)]
    return folded[near[0]] if near else None


def counted(number: int, noun: str, plural: str | None = None) -> str:
    """``1 frame``, ``2 frames``; ``plural`` where it is not the noun and an s."""
    return f"{number} {noun if number == 1 else plural or f'{noun}s'}"


def resolve(path: str) -> Any:
    """The object that ``"module:attribute"`` names; its module is imported.

    Raises:
        ValueError: another form, no such module, or one without this attribute (the nearest match is named).
        ImportError: the module is there, but can't be imported.
    """
    module, _, attribute = path.partition(":")
    if not module or not attribute.isidentifier():
        raise ValueError(f"an object is named module:attribute, such as my_package.physics:MyBackend, got {path!r}")
    try:
        found = import_module(module)
    except Exception as error:  # a stranger's module may raise anything
        lacks = (error.name or "") if isinstance(error, ModuleNotFoundError) else ""
        if isinstance(error, ModuleNotFoundError) and lacks.split(".")[0] in EXTRAS:
            raise ImportError(missing(repr(path), error)) from error
        if lacks and f"{module}.".startswith(f"{lacks}."):
            raise ValueError(
                f"there is no module {lacks!r} for {path!r}: install the package that holds it, or add its folder to "
                "PYTHONPATH"
            ) from error
        raise ImportError(
            f"{path!r} can't be imported ({type(error).__name__}: {error}): repair the module, or install what it needs"
        ) from error
    if not hasattr(found, attribute):
        own = [name for name, value in vars(found).items() if getattr(value, "__module__", None) == module]
        raise unknown_name(f"attribute of module {module!r}:", attribute, own)
    return getattr(found, attribute)
