"""Weights with their card: ``<name>.safetensors`` holds both, and ``<name>.json`` beside it a copy of the card to read.

The card's ``sha256`` is that of the whole file of weights, where it stands as ``BLANK``.
"""

import hashlib
import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from safetensors.numpy import load as parse
from safetensors.numpy import save as serialise

from cloth_envs.files import check_folder, reading, write_bytes, write_text
from cloth_envs.naming import unknown_name

WEIGHTS = Path(__file__).parent / "weights"
BLANK = 64 * "0"


class Checkpoint(NamedTuple):
    """Arrays by name, and what is known of them: recipe, data, measured errors, valid range, licence."""

    arrays: dict[str, np.ndarray]
    card: dict[str, Any]

    def of_factor(self, factor: int) -> dict[str, np.ndarray]:
        """The arrays ``<factor>.<array>`` by the array's name; empty if there are none."""
        prefix = f"{factor}."
        return {key[len(prefix) :]: value for key, value in self.arrays.items() if key.startswith(prefix)}


def save(name: str, arrays: Mapping[str, np.ndarray], card: Mapping[str, Any], folder: Path = WEIGHTS) -> Path:
    """Write weights and card as one file, which is replaced only when the new one is whole on disk, and the copy.

    Returns:
        The path of the weights.

    Raises:
        OSError: they can't be written; names the file.
    """
    check_folder(folder)
    path = folder / f"{name}.safetensors"
    text = json.dumps({"sha256": BLANK} | dict(card) | {"sha256": BLANK}, indent=1) + "\n"
    data = serialise({key: np.ascontiguousarray(value) for key, value in arrays.items()}, {"card": text})
    own = hashlib.sha256(data).hexdigest()
    write_bytes(path, data.replace(BLANK.encode(), own.encode(), 1))
    write_text(path.with_suffix(".json"), text.replace(BLANK, own))
    load.cache_clear()
    return path


@cache
def load(name: str, folder: Path = WEIGHTS) -> Checkpoint:
    """The weights ``name`` and their card, read once until others are saved.

    Raises:
        ValueError: there are none of this name (the nearest match is named), or they or the card in them are damaged.
    """
    path = folder / f"{name}.safetensors"
    if not path.is_file():
        raise unknown_name("weights", name, sorted(p.stem for p in folder.glob("*.safetensors")))
    with reading(path, "restore it, or train it anew"):
        data = path.read_bytes()
        length = 8 + int.from_bytes(data[:8], "little")
        text = json.loads(data[8:length]).get("__metadata__", {}).get("card")
        if text is None:
            raise ValueError("there is no card in it")
        card: dict[str, Any] = json.loads(text)
        own = str(card["sha256"])
        if hashlib.sha256(data.replace(own.encode(), BLANK.encode(), 1)).hexdigest() != own:
            raise ValueError("it does not have its checksum")
        return Checkpoint(parse(data), card)


def of_factor(name: str, factor: int) -> dict[str, np.ndarray]:
    """The shipped arrays ``<factor>.<array>`` of a scene's checkpoint by the array's name; empty if there are none."""
    return load(name).of_factor(factor) if (WEIGHTS / f"{name}.safetensors").is_file() else {}


def written(name: str, folder: Path) -> Checkpoint:
    """All arrays of such a checkpoint in ``folder``, read anew, and what its card says of every factor."""
    if not (folder / f"{name}.safetensors").is_file():
        return Checkpoint({}, {})
    load.cache_clear()  # another process may have written it
    arrays, card = load(name, folder)
    return Checkpoint(dict(arrays), dict(card["factors"]))


def add_factor(
    name: str, factor: int, arrays: Mapping[str, np.ndarray], about: Any, card: Mapping[str, Any], folder: Path
) -> None:
    """Write one factor's arrays into such a checkpoint, and ``about`` them into its card; other factors stay."""
    known, done = written(name, folder)
    known = {key: value for key, value in known.items() if not key.startswith(f"{factor}.")}
    known |= {f"{factor}.{key}": value for key, value in arrays.items()}
    save(name, known, {**card, "factors": done | {str(factor): about}}, folder)
