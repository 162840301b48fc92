"""Where what took long is kept, and how: under a name that tells what it was made of, whole or not at all."""

import hashlib
import os
from collections.abc import Callable, Mapping
from io import BytesIO
from pathlib import Path

import numpy as np

from cloth_envs.files import check_folder, check_zip, reading, write_bytes


def cache_folder(kind: str, given: Path | None = None) -> Path:
    """``given``, or ``minicloth/<kind>`` among the user's caches."""
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return given or home / "minicloth" / kind


def digest(*parts: object) -> str:
    """Sixteen digits that tell ``parts``: arrays and bytes by their content, anything else by its ``repr``."""
    total = hashlib.sha256()
    for part in parts:
        if isinstance(part, np.ndarray):
            part = np.ascontiguousarray(part).tobytes()
        total.update(part if isinstance(part, bytes) else repr(part).encode())
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
