"""Weights on disk: exact, and refused when they are not those of their card."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from surrogates.checkpoint import WEIGHTS, load, save


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


def test_saved_again_is_loaded_again(tmp_path: Path) -> None:
    for value in (1, 2):
        save("net", {"a": np.full(3, value)}, {"value": value}, tmp_path)
        found = load("net", tmp_path)
        assert (found.card["value"], found.arrays["a"][0]) == (value, value)


KILLED = """
import os, signal, sys
from pathlib import Path
import numpy as np
from surrogates import checkpoint
folder, limit, replace = Path(sys.argv[1]), int(sys.argv[2]), Path.replace
def killed(self, target):
    global limit
    limit -= 1
    if limit < 0:
        os.kill(os.getpid(), signal.SIGKILL)
    return replace(self, target)
Path.replace = killed
checkpoint.save("net", {"a": np.ones(3)}, {"value": 2}, folder)
"""


@pytest.mark.parametrize(("limit", "value"), [(0, 1), (1, 2)])
def test_killed_between_two_files(limit: int, value: int, tmp_path: Path) -> None:
    """Old or new ones are whole, and what is left beside them is no checkpoint."""
    save("net", {"a": np.zeros(3)}, {"value": 1}, tmp_path)
    done = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path), str(limit)], check=False)
    assert done.returncode == -9
    load.cache_clear()
    found = load("net", tmp_path)
    assert (found.card["value"], found.arrays["a"][0]) == (value, value - 1)
    assert [path.name for path in tmp_path.glob("*.safetensors")] == ["net.safetensors"]


def test_shipped_weights_are_whole_and_their_cards_are_copies() -> None:
    shipped = sorted(WEIGHTS.glob("*.safetensors"))
    assert len(shipped) > 30
    for path in shipped:
        assert load(path.stem).card == json.loads(path.with_suffix(".json").read_text())
