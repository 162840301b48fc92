"""Weights with their card: ``<name>.safetensors`` and ``<name>.json`` beside it, which holds the checksum."""

import hashlib
import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from safetensors.numpy import load as parse
from safetensors.numpy import save as serialise

from cloth_envs.files import check_folder, read_json, replacing
from cloth_envs.naming import unknown_name

WEIGHTS = Path(__file__).parent / "weights"


class Checkpoint(NamedTuple):
    """Arrays by name, and what is known of them: recipe, data, measured errors, valid range, licence."""

    arrays: dict[str, np.ndarray]
    card: dict[str, Any]


def save(name: str, arrays: Mapping[str, np.ndarray], card: Mapping[str, Any], folder: Path = WEIGHTS) -> Path:
    """Write weights and card; the old ones are replaced only when the new ones are whole on disk.

    Returns:
        The path of the weights.

    Raises:
        OSError: they can't be written; names the file.
    """
    check_folder(folder)
    path = folder / f"{name}.safetensors"
    data = serialise({key: np.ascontiguousarray(value) for key, value in arrays.items()})
    text = json.dumps({"sha256": hashlib.sha256(data).hexdigest(), **card}, indent=1) + "\n"
    with replacing(path) as weights, replacing(path.with_suffix(".json")) as beside:
        weights.write_bytes(data)
        beside.write_bytes(text.encode())
    return path


@cache
def load(name: str, folder: Path = WEIGHTS) -> Checkpoint:
    """The weights ``name`` and their card, read once.

    Raises:
        ValueError: there are none of this name (the nearest match is named), they are not those of the card, or the
            card is damaged.
    """
    path = folder / f"{name}.safetensors"
    if not path.is_file():
        raise unknown_name("weights", name, sorted(p.stem for p in folder.glob("*.safetensors")))
    beside = path.with_suffix(".json")
    card = read_json(beside, "sha256", remedy="restore it beside its weights, or train them anew")
    data = path.read_bytes()
    if hashlib.sha256(data).hexdigest() != card["sha256"]:
        raise ValueError(
            f"{path} does not have the checksum of its card: it was changed or cut off; "
            "restore both files, or train it anew"
        )
    return Checkpoint(parse(data), card)


def of_factor(name: str, factor: int) -> dict[str, np.ndarray]:
    """The shipped arrays ``<factor>.<array>`` of a scene's checkpoint by the array's name; empty if there are none."""
    prefix = f"{factor}."
    arrays = load(name).arrays if (WEIGHTS / f"{name}.safetensors").is_file() else {}
    return {key[len(prefix) :]: value for key, value in arrays.items() if key.startswith(prefix)}


def written(name: str, folder: Path) -> Checkpoint:
    """All arrays of such a checkpoint in ``folder``, read anew, and what its card says of every factor."""
    if not (folder / f"{name}.safetensors").is_file():
        return Checkpoint({}, {})
    load.cache_clear()
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
