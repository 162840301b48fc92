"""``examples/own_backend.py``, a backend from outside the package, at every door."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import cloth_envs
from cloth_envs.commands.cli import main
from cloth_envs.state import Controls
from training.bench.speed_accuracy.rows import SpeedAccuracyRow
from training.rows import read_rows

EXAMPLES = Path(__file__).parents[1] / "examples"
SMALL = {"resolution": (13, 9)}


@pytest.fixture(autouse=True)
def own(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The example, imported; the table of backends is put back afterwards."""
    assert len((EXAMPLES / "own_backend.py").read_text().splitlines()) <= 40
    monkeypatch.setattr("cloth_envs.registry.BACKENDS", dict(cloth_envs.BACKENDS))
    monkeypatch.syspath_prepend(EXAMPLES)
    monkeypatch.delitem(sys.modules, "own_backend", raising=False)
    import own_backend

    return own_backend


def make(backend: str, **options: Any) -> Any:
    return gym.make("MiniCloth-Curtain-v0", backend=backend, **SMALL, **options).unwrapped


def test_gymnasium_checker_is_clean() -> None:
    check_env(make("springs"), skip_render_check=True)


def test_it_is_the_reference_without_what_it_leaves_out() -> None:
    ends, limp = [], {"bend_stiffness": 0.0, "damping": 0.0, "drag": 0.0}
    for backend, options in (("springs", {}), ("reference", {"backend_kwargs": {"solver": "explicit"}})):
        env = make(backend, preset="lee2019", material=limp, **options)  # a curtain without air
        env.reset(seed=1)
        for _ in range(3):
            env.step(np.full(2, 0.5, np.float32))
        ends.append(env.state.positions)
    # The same law and step; the reference in float32: on average half a rounding error of 1.5 m in each of some hundred
    # substeps, which add up like a random walk, doubled by the springs.
    assert abs(ends[0] - ends[1]).max() < 2 * np.sqrt(300) * 1.5 * np.finfo(np.float32).eps


def test_a_frame_has_the_slope_that_differences_have(own: Any) -> None:
    import torch

    env = make("springs")
    env.reset(seed=1)
    springs, controls = own.Springs(env.scene), Controls.hold(env.state, env.scene.handles)
    start = torch.tensor(env.state.positions, dtype=torch.float64)
    way = torch.randn(start.shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    way.flatten(2)[..., list(env.scene.handles)] = 0.0

    def bent(x: torch.Tensor) -> torch.Tensor:
        still, end = torch.zeros_like(x), torch.zeros_like(x)
        old, new = (
            replace(env.state, positions=x, velocities=still),
            replace(env.state, positions=end, velocities=end.clone()),
        )
        springs.step(old, new, controls)
        return (end**2).sum()

    (slope,) = torch.autograd.grad(bent(start.requires_grad_()), start)
    e = 1e-6
    with torch.no_grad():
        difference = (bent(start + e * way) - bent(start - e * way)) / (2 * e)
    # A central difference: eps / e of the sum, and e^2 times the third derivative, over the stable steps of a frame.
    assert float((slope * way).sum()) == pytest.approx(float(difference), rel=1e-6)


def test_a_vector_environment_steps_like_single_ones() -> None:
    many = gym.make_vec("MiniCloth-Curtain-v0", num_envs=2, backend="springs", **SMALL)
    many.reset(seed=3)
    seen = many.step(np.full((2, 2), 0.5, np.float32))[0]
    for i in range(2):
        one = make("springs")
        one.reset(seed=3 + i)
        np.testing.assert_allclose(one.step(np.full(2, 0.5, np.float32))[0], seen[i], atol=1e-6)


def test_what_it_does_not_model_is_refused() -> None:
    with pytest.raises(ValueError, match="choose Curtain"):
        gym.make("MiniCloth-Flag-v0", backend="springs").reset()
    with pytest.raises(ValueError, match="leave randomize out"):
        gym.make_vec(
            "MiniCloth-Curtain-v0", num_envs=2, backend="springs", randomize={"drag": (0.1, 0.2)}, **SMALL
        ).reset()


def test_the_command_line_compares_it(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    options = ["--resolutions", "13x9", "--frames", "2", "--no-video", "--out", str(tmp_path)]
    assert main(["compare", "Curtain", "--backend", "own_backend:Springs", *options]) == 0
    assert "own_backend:Springs 13x9" in capsys.readouterr().out


def test_a_benchmark_measures_it(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    options = [
        "--scenes",
        "Curtain",
        "--families",
        "explicit,repeat last frame",
        "--out",
        str(tmp_path),
        "--cache",
        str(tmp_path),
    ]
    with pytest.raises(SystemExit, match="0"):
        main(["bench", "speed-accuracy", "--quick", "--backend", "own_backend:Springs", *options])
    found = read_rows(tmp_path / "speed_accuracy.csv", SpeedAccuracyRow)
    errors = {row.family: row.error for row in found if row.frames == 5 and row.options == "{}"}
    # No damping and bending: farther from the truth than explicit, nearer than a cloth that stays where it is.
    assert errors["explicit"] < errors["own_backend:Springs"] < errors["repeat last frame"]
    assert "own_backend:Springs" in capsys.readouterr().out
