"""Weights on disk: exact, and refused when they are not those of their card."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from surrogates.checkpoint import load, save


def test_arrays_and_card_come_back(tmp_path: Path) -> None:
    arrays = {"a": np.arange(6, dtype=np.float32).reshape(2, 3), "b": np.float64(3.5)[None]}
    save("net", arrays, {"recipe": "none"}, tmp_path)
    found = load("net", tmp_path)
    assert found.card["recipe"] == "none"
    assert set(found.arrays) == {"a", "b"}
    for name, value in arrays.items():
        np.testing.assert_array_equal(found.arrays[name], value, strict=True)


def test_changed_weights_are_refused(tmp_path: Path) -> None:
    path = save("net", {"a": np.zeros(4)}, {}, tmp_path)
    data = bytearray(path.read_bytes())
    data[-1] ^= 1
    path.write_bytes(data)
    with pytest.raises(ValueError, match="checksum"):
        load("net", tmp_path)


def test_an_unknown_name_names_the_nearest(tmp_path: Path) -> None:
    save("flag", {"a": np.zeros(1)}, {}, tmp_path)
    with pytest.raises(ValueError, match="flag"):
        load("flaq", tmp_path)
