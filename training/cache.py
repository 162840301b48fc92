"""Where what took long is kept, and how: under a name that tells what it was made of, whole or not at all."""

import hashlib
import os
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from io import BytesIO
from pathlib import Path

import numpy as np

from cloth_envs.files import check_folder, check_zip, reading, write_bytes


def cache_folder(kind: str, given: Path | None = None) -> Path:
    """``given``, or ``minicloth/<kind>`` among the user's caches."""
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return given or home / "minicloth" / kind


def spelled(value: object) -> str:
    """The ``repr`` of ``value`` with every field of the dataclasses in it, where their own is short."""
    if is_dataclass(value) and not isinstance(value, type):
        inside = ", ".join(f"{field.name}={spelled(getattr(value, field.name))}" for field in fields(value))
        return f"{type(value).__qualname__}({inside})"
    return f"[{', '.join(map(spelled, value))}]" if isinstance(value, list) else repr(value)


def digest(*parts: object) -> str:
    """Sixteen digits that tell ``parts``: arrays and bytes by their content, anything else as ``spelled``."""
    total = hashlib.sha256()
    for part in parts:
        if isinstance(part, np.ndarray):
            part = np.ascontiguousarray(part).tobytes()
        total.update(part if isinstance(part, bytes) else spelled(part).encode())
    return total.hexdigest()[:16]


def cached_arrays(path: Path, make: Callable[[], Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """The arrays of ``path`` (``.npz``); where it is missing they are made, and it appears when it is whole.

    Raises:
        OSError: it can't be written.
        ValueError: it is damaged.
    """
    if not path.is_file():
        content = BytesIO()
        np.savez(content, **make())  # type: ignore[arg-type]
        check_folder(path.parent)
        write_bytes(path, content.getvalue())
    with reading(path, "remove it, it is made again"):
        check_zip(path)
        with np.load(path) as file:
            return dict(file)
