"""Training of the published networks: it goes on where it stopped, writes what it trained, and learns."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from cloth_envs.commands.cli import main as minicloth
from surrogates import checkpoint
from surrogates.upscale.published import Mlp
from training.fit import Kept
from training.generate import Plan, generate
from training.upscaler.data import Pairs, read, shards
from training.upscaler.recipes import RECIPES, SCENES, SHAPES, Recipe
from training.upscaler.train import Scaling, errors, train

Stopped = Callable[[int], AbstractContextManager[object]]
TINY = Recipe("Flag", layers=2, width=24, steps=6, batch=32)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("flag")
    generate(Plan("Flag", frames=100, factors=(2,)), path, 10)
    return path


@pytest.fixture(scope="module")
def pairs(folder: Path) -> Callable[[bool], Pairs]:
    made = {
        h: Pairs([read(p, 2) for p in shards(folder, held_out=h)], "Flag", 2, inputs="oracle") for h in (False, True)
    }
    return made.__getitem__


@pytest.mark.parametrize("start", ["bilinear", "random"])
def test_the_folded_network_is_the_trained_one(start: str, pairs: Callable[[bool], Pairs]) -> None:
    """In absolute coordinates, of the recipe's width, and before any training bilinear interpolation."""
    recipe = replace(TINY, start=start)
    scaling = Scaling(recipe, pairs(False))
    rng = np.random.default_rng(0)
    width = recipe.width - (12 if start == "bilinear" else 0)
    sizes = [(width, 36), (width, width), (27, width)]
    weights = [(rng.normal(0, 1 / np.sqrt(shape[1]), shape), rng.normal(0, 0.1, shape[0])) for shape in sizes]
    arrays = scaling.fold(weights)
    assert [arrays[f"weight{k}"].shape for k in range(3)] == [(24, 36), (24, 24), (27, 24)]
    x, _ = pairs(True).draw(rng, 200)
    inner = (x.astype(np.float64) - scaling.mean) @ scaling.white
    for k, (w, b) in enumerate(weights):
        inner = inner @ w.T + b
        inner = np.maximum(inner, 0) if k < 2 else inner
    expected = x @ scaling.linear + scaling.offset + scaling.spread * inner
    # The first layer sees coordinates of metres through whitening, which enlarges their rounding, 36 terms of it.
    eps = float(np.finfo(np.float32).eps)
    rounding = 36 * eps * (np.abs(x) @ np.abs(scaling.white)).max() * scaling.spread * 4
    # The units that pass corners on hold up to twice 8 standard deviations, each rounded once in every layer.
    passed = 3 * 12 * eps * 16 * scaling.scale.max() if start == "bilinear" else 24 * eps * np.abs(expected).max()
    assert np.abs(Mlp(arrays)(x) - expected).max() <= rounding + passed
    if start == "bilinear":
        still = [(0 * w, 0 * b) for w, b in weights]
        plain = x @ scaling.linear + scaling.offset
        assert np.abs(Mlp(scaling.fold(still))(x) - plain).max() <= passed


def test_training_goes_on_where_it_stopped(tmp_path: Path, pairs: Callable[[bool], Pairs], stopped: Stopped) -> None:
    kept = {name: Kept(tmp_path / f"{name}.pt", repr(TINY), every=2) for name in "ab"}
    whole, _ = train(TINY, pairs(False), kept["a"])
    with stopped(3):
        train(TINY, pairs(False), kept["b"])
    assert torch.load(kept["b"].path)["done"] == 2
    parts, _ = train(TINY, pairs(False), kept["b"])
    assert whole.keys() == parts.keys()
    for name, array in whole.items():
        np.testing.assert_array_equal(parts[name], array)
    early, _ = train(replace(TINY, steps=2), pairs(False), Kept(tmp_path / "c.pt", ""))
    assert np.abs(early["weight0"] - whole["weight0"]).max() > 0


def test_training_descends_from_the_interpolation_that_it_starts_from(
    tmp_path: Path, pairs: Callable[[bool], Pairs]
) -> None:
    """Some seconds of training: a third of bilinear's squared error on what it learnt from, when this was written, and
    half of it on trajectories that it never saw. That the shipped networks are better is told by their cards.
    """
    torch.set_num_threads(1)
    recipe = replace(TINY, width=48, steps=800, batch=256, rate=4e-3, start="bilinear")
    arrays, _ = train(recipe, pairs(False), Kept(tmp_path / "tiny.pt", ""))
    for held in (False, True):
        card = errors(arrays, pairs(held))
        assert card["mse"] < card["linear mse"]


def test_the_command_writes_weights_with_their_card(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setitem(RECIPES, "fc-flag-2", TINY)
    with pytest.raises(SystemExit) as done:
        minicloth(["train", "upscaler", "--recipe", "fc-flag-2", "--data", str(folder), "--out", str(tmp_path)])
    assert done.value.code == 0
    assert "linear mse" in capsys.readouterr().out
    found = checkpoint.load("fc_flag_2", tmp_path)
    assert found.arrays["weight0"].shape == (24, 36)
    assert found.card["licence"] == "MIT"
    assert found.card["data"]["trajectories"] == {"learnt from": 8, "held out": 2}
    assert found.card["recipe"]["steps"] == 6
    assert minicloth(["train", "upscaler", "--recipe", "fc-flog-2"]) == 2
    assert "Did you mean 'fc-flag-2'" in capsys.readouterr().err


def test_recipes_cover_the_paper() -> None:
    wanted = {Recipe(scene, layers=u, width=v) for scene in SCENES for u, v in SHAPES}
    wanted |= {Recipe(scene, factor) for scene in SCENES for factor in (2, 3, 4)}
    wanted |= {Recipe("Flag", features=features) for features in ("positions", "velocities", "frames")}
    assert wanted <= set(RECIPES.values())
