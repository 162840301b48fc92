"""The seed's tables with networks: rows are the numbers they claim to be, and a stopped run is completed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import cloth_envs
from surrogates.checkpoint import WEIGHTS, load
from training.bench.papers import chart, published
from training.bench.papers.published import (
    FRAME_KEY,
    PUBLISHED_KEY,
    FrameErrorRow,
    PublishedRow,
    fill,
    pairs,
    score,
    windows,
)
from training.bench.papers.runs import (
    PRESET,
    UNSCALED,
    UPSCALERS,
    by_frame,
    held_out,
    measured,
    motion,
    teacher,
    unscaled,
)
from training.bench.participants import extra
from training.generate import miniature
from training.rows import Store
from training.upscaler.recipes import RECIPES, SCENES

FRAMES = 4


def played(backend: str, options: dict[str, Any]) -> np.ndarray:
    """Positions ``(FRAMES, 3, H, W)`` of an environment with zero actions, its controls from its own state."""
    env = gym.make(cloth_envs.env_id("Flag"), backend=backend, backend_kwargs=options, preset=PRESET)
    env.reset(seed=0)
    found = []
    for _ in range(FRAMES):
        env.step(np.zeros(env.action_space.shape, np.float32))
        found.append(env.unwrapped.world.state.positions[0].copy())  # type: ignore[attr-defined]
    return np.stack(found)


def test_rows_of_a_free_run_are_those_of_the_backend() -> None:
    """The miniature is run once and upscaled by all; one upscaler at a time inside the backend must say the same."""
    rows, points = score("T7", "Flag", 2, FRAMES, {})
    free = {r.method: r for r in rows if r.protocol == "free"}
    assert set(UPSCALERS) | {UNSCALED, "teacher nudged"} <= set(free)
    truth = played("reference", {})
    for name in ("bicubic", "fc", "hdnn"):
        options = {"upscaler": name, "solver": "admm", "solver_kwargs": {"iterations": 10}}
        found = played("miniature", options)
        # The same float32 numbers of up to 1.5 m on either way; their mean distance may differ by rounding,
        # 2 * 1.5 eps = 4e-7.
        assert free[name].value == pytest.approx(by_frame(found, truth).mean(), abs=4e-7)
        last = [p for p in points if (p.protocol, p.method, p.frame) == ("free", name, FRAMES)]
        assert last[0].error == pytest.approx(float(by_frame(found, truth)[-1]), abs=4e-7)
    assert free["fc"].paper == published.TABLE_7["Flag"][1]
    assert free[UNSCALED].paper == published.TABLE_7["Flag"][0]
    assert 0 < free["teacher nudged"].value < free["bicubic"].value
    oracle = {r.method: r.value for r in rows if r.protocol == "oracle"}
    assert oracle["bicubic"] < free["bicubic"].value


def test_without_wind_the_unscaled_coarse_cloth_is_as_stiff_as_the_papers_miniature() -> None:
    """Both have the stiffness over the mass that is s^2 times too large; that is why table 7 has them nearly equal.

    Bending differs, and hardly counts: a tenth of the error at most.
    """
    run = teacher("Curtain", 20)
    runs = [miniature(run, 2, 0, 20, **options) for options in (unscaled(2), {"scaling": "seed"}, {})]
    hdnn, seed, similar = (np.stack([s.positions[0] for s in states]) for states in runs)
    assert by_frame(hdnn, seed).mean() < 0.1 * by_frame(seed, similar).mean()


def test_readings_tell_a_flag_that_stands_still_from_one_that_waves() -> None:
    run = teacher("Flag", 8)
    first = run.states[0].positions
    still = replace(
        run, states={k: replace(s, positions=first, velocities=0 * s.velocities) for k, s in run.states.items()}
    )
    width = run.scene.grid.width
    # float32 positions of up to 1.5 m: 1.5 eps.
    assert motion(still) == pytest.approx({"fly": width, "waves": 0.0, "speed": 0.0}, abs=2e-7)
    assert min(motion(run).values()) > 1e-3
    found = measured({"tangential": 0.1}, 8)
    assert set(found) == {("bicubic", "error"), ("bicubic", "worst"), ("teacher nudged", "error")} | {
        ("teacher", name) for name in motion(run)
    }
    assert 0 < found["teacher nudged", "error"] < found["bicubic", "error"] < found["bicubic", "worst"]


def test_windows_start_again_from_the_teacher() -> None:
    found = {(r.method, r.protocol, r.frames, r.measure): r.value for r in windows("Flag", 2, 1)}
    first = found["bicubic", "windows", 1, "error"]
    assert 0 < first < found["bicubic", "windows", 20, "error"]  # the miniature drifts away
    assert 0 < found["fc", "oracle", 100, "seam"] < found["fc", "oracle", 100, "error"]
    (run,) = held_out("Flag", 1)
    start = miniature(run, 2, 40, 1)[2]
    np.testing.assert_array_equal(start.positions, run.states[40].positions[:, :, ::2, ::2])


def test_rows_of_pairs_come_from_cards() -> None:
    rows = list(pairs([WEIGHTS]))
    card = load("fc_flag_2").card["errors"]
    three = {r.protocol: r.value for r in rows if (r.table, r.options) == ("T3", "frames")}
    assert three == {split: card[split]["mse"] for split in ("learnt from", "held out")}
    five = {r.scene: r for r in rows if (r.table, r.options) == ("T5", "4*FC-64")}
    assert set(five) == set(SCENES)
    assert five["Flag"].paper == 1.217e-4
    assert card["held out"]["mse"] < card["held out"]["linear mse"]


def test_a_stopped_run_is_completed_and_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stores() -> tuple[Store[PublishedRow], Store[FrameErrorRow]]:
        rows = Store(tmp_path / "a.csv", PublishedRow, PUBLISHED_KEY)
        return rows, Store(tmp_path / "b.csv", FrameErrorRow, FRAME_KEY)

    monkeypatch.setattr(published, "FACTORS", (2,))
    monkeypatch.setattr(published, "READINGS", published.READINGS[:1])
    monkeypatch.setattr(published, "VARIED", {name: options[:1] for name, options in published.VARIED.items()})
    whole, calls = published.score, []

    def counted(*args: Any) -> Any:
        calls.append(args[0])
        if len(calls) == 3:
            raise KeyboardInterrupt
        return whole(*args)

    monkeypatch.setattr(published, "score", counted)
    with pytest.raises(KeyboardInterrupt):
        fill(*stores(), ["Flag"], frames=2, count=1)
    rows, points = stores()
    assert {r.table for r in rows.rows} == {"T3", "T5", "T7", "T4"}
    fill(rows, points, ["Flag"], extra(["reference"]), frames=2, count=1)
    assert calls == ["T7", "T4", "fig13", "fig13", "fig14", "fig15", "fig15"]
    assert {r.table for r in rows.rows} == {
        "T3",
        "T4",
        "T5",
        "T7",
        "T8",
        "fig13",
        "fig14",
        "fig15",
        "held out",
        "readings",
    }
    said = published.table(rows.rows)
    assert "T7: errors in m" in said
    assert "(0.007767)" in said
    assert "Flag s=2  reference " in said
    chart.draw({"published": rows.rows, "published_frames": points.rows}, tmp_path, "")
    for name in ("frames", "variants"):
        assert (tmp_path / f"published_{name}.png").stat().st_size > 20_000


def test_every_shipped_recipe_has_its_weights_small_and_with_a_card() -> None:
    there = {path.stem for kind in ("fc", "hdnn") for path in WEIGHTS.glob(f"{kind}_*.safetensors")}
    assert there <= {name.replace("-", "_") for name in RECIPES}
    assert {f"fc_{scene.lower()}_{factor}" for scene in SCENES for factor in (2, 3, 4)} <= there
    for name in there:
        card = load(name).card
        assert (WEIGHTS / f"{name}.safetensors").stat().st_size < 1e6
        assert card["licence"] == "MIT"
        assert {"recipe", "data", "errors", "valid"} <= set(card)
