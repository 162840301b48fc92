"""Arguments as users write them: NumPy's numbers and arrays beside Python's own, and a sentence for all others."""

import operator
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cloth_envs.naming import counted, unknown_name

FLOATS = ("float32", "float64")


def as_whole(value: Any) -> int | None:
    """A whole number of Python or NumPy as an int; None for all else, such as True or 2.0."""
    if isinstance(value, (bool, np.bool_)):
        return None
    try:
        return operator.index(value)
    except TypeError:
        return None


def as_number(value: Any) -> float | None:
    """A real number of Python or NumPy, or an array of no axes, as a float; None for all else, such as True or "1"."""
    if isinstance(value, float):
        return value
    array = as_array(value)
    return float(array) if array is not None and array.ndim == 0 else None


def as_array(value: Any) -> np.ndarray | None:
    """Real numbers in any nesting as an array; None for booleans, text, complex numbers, ragged lists and objects."""
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, RuntimeError):
        return None
    return array if array.dtype.kind in "iuf" else None


def as_items(value: Any) -> list[Any] | None:
    """A list, tuple or array of one axis as a list; None for all else."""
    if isinstance(value, np.ndarray):
        return value.tolist() if value.ndim == 1 else None
    return list(value) if isinstance(value, Sequence) and not isinstance(value, (str, bytes)) else None


def per_member(name: str, value: Any, count: int) -> list[Any]:
    """What ``value`` says of each of ``count`` environments: a list has one entry for each, all else is for all.

    Raises:
        ValueError: a list of another length.
    """
    items = as_items(value)
    if items is None:
        return [value] * count
    if len(items) != count:
        raise ValueError(
            f"{name} lists {len(items)} for {counted(count, 'environment')}: give one entry for each, or write "
            f"gymnasium.make_vec(id, num_envs={len(items)}, ...)"
        )
    return items


def as_plain(value: Any) -> Any:
    """``value``, and what a dict holds, with NumPy's numbers as Python's own; arrays stay."""
    if isinstance(value, Mapping):
        return {name: as_plain(item) for name, item in value.items()}
    return value.item() if isinstance(value, np.generic) else value


def whole_number(name: str, value: object, least: int = 1) -> int:
    """``value`` as an int. Raises ValueError: not a whole number of at least ``least``."""
    found = as_whole(value)
    if found is None or found < least:
        raise ValueError(f"{name} must be a whole number of at least {least}, got {value!r}")
    return found


def true_or_false(name: str, value: object) -> bool:
    """``value`` as a bool. Raises ValueError: neither Python's nor NumPy's True or False."""
    if not isinstance(value, (bool, np.bool_)):
        raise ValueError(f"{name} must be True or False, got {value!r}")
    return bool(value)


def one_of(what: str, value: object, choices: Sequence[str] | Mapping[str, Any]) -> str:
    """``value`` as it is. Raises ValueError: not among ``choices``; the nearest match is named."""
    if not isinstance(value, str) or value not in choices:
        raise unknown_name(what, value, choices)
    return value


def float_type(value: Any) -> np.dtype[Any]:
    """The NumPy type that ``"float32"`` or ``"float64"``, a type or a dtype names. Raises ValueError: it names none."""
    try:
        found = None if value is None else np.dtype(value)
    except TypeError:
        found = None
    if found is None or found.name not in FLOATS:
        raise unknown_name("dtype", value, FLOATS)
    return found


def check_seed(value: object) -> int | None:
    """A seed as an int, or None. Raises ValueError: neither None nor a whole number of at least 0."""
    return None if value is None else whole_number("seed", value, 0)


def check_seeds(value: object, count: int) -> list[int | None]:
    """A seed for each of ``count`` environments: ``value``, ``value + 1``, ..., or those that a sequence holds.

    Raises:
        ValueError: neither a seed nor a sequence of so many seeds or Nones.
    """
    if value is None:
        return [None] * count
    first, items = as_whole(value), as_items(value)
    if first is not None:
        return [whole_number("seed", first, 0) + i for i in range(count)]
    if items is None:
        raise ValueError(f"seed must be a whole number of at least 0 or a list of {count} of them, got {shown(value)}")
    if len(items) != count:
        raise ValueError(f"got {len(items)} seeds for {count} environments; pass one number or {count} of them")
    return [check_seed(item) for item in items]


def check_reset_options(options: object, known: Sequence[str] = ()) -> dict[str, Any]:
    """What ``reset(options=...)`` was given. Raises ValueError: no dict, or an option that is not ``known``."""
    if options is None:
        return {}
    if not isinstance(options, Mapping):
        raise ValueError(f"options of reset must be a dict or None, got {options!r}")
    for name in options:
        if not known:
            raise ValueError(f"a single environment has no reset options, got {name!r}: leave options out")
        one_of("option of reset", name, known)
    return dict(options)


def check_mask(value: Any, count: int) -> np.ndarray:
    """Which of ``count`` environments are reset, bool ``(count,)``. Raises ValueError: no such mask."""
    try:
        mask = np.asarray(value)
    except ValueError:
        mask = np.zeros(0)
    if mask.shape != (count,) or mask.dtype != bool or not mask.any():
        raise ValueError(f"reset_mask must be a bool array of shape ({count},) that picks at least one environment")
    return mask


def read_actions(given: Any, shape: tuple[int, ...], meaning: Sequence[str]) -> np.ndarray:
    """Actions as a float64 array of ``shape``, whose last axis is what ``meaning`` says.

    Raises:
        ValueError: not numbers, or of another shape.
    """
    actions = as_array(given)
    if actions is None:
        raise ValueError(
            f"action must be numbers in [-1, 1] of shape {shape} ({', '.join(meaning)}), got {shown(given)}"
        )
    if actions.shape != shape:
        raise ValueError(f"action has shape {actions.shape}, expected {shape}: {', '.join(meaning)}")
    return actions.astype(np.float64, copy=False)


def shown(value: object) -> str:
    """The start of what ``repr`` says, on one line: arrays are long."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:57]}..."
