"""``minicloth bench peers``: every engine gets the same cloth, and what is asked of a run can fail."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from cloth_envs.backend import Backend
from cloth_envs.naming import resolve
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from training.bench.benchmark import find
from training.bench.peers import results
from training.bench.peers import run as peers
from training.bench.peers.results import TOLERANCE
from training.bench.peers.scenes import (
    DROP,
    EARLY,
    LATE,
    NAMES,
    RADIUS,
    WAVE,
    Peer,
    Setup,
    build,
    error_mm,
    follow,
    lag,
    p99,
)  # fmt: skip
from training.rows import read_rows

PEERS = ("Taichi", "MuJoCo")
pytestmark = pytest.mark.filterwarnings("ignore:'locale.getdefaultlocale:DeprecationWarning")  # Taichi's import


@pytest.fixture(params=PEERS)
def peer(request: pytest.FixtureRequest) -> Callable[..., Peer]:
    """What builds the engine; the test is skipped where it is not installed."""
    if reason := peers.missing(request.param):
        pytest.skip(reason)
    return resolve(peers.CLASSES[request.param])


def truth(setup: Setup, **options: object) -> Any:
    return peers.make(peers.setting(results.OWN, {**peers.TRUTH, **options}), setup)


def test_scenes_are_those_of_the_table() -> None:
    a, b, c = (build(name) for name in NAMES)
    assert [s.scene.grid.vertices for s in (a, b, c)] == [49 * 73, 33 * 49, 41 * 61]
    assert [s.scene.frame_dt for s in (a, b, c)] == [0.04, 0.04, 0.02]
    for setup in (a, b, c):
        # 0.2 kg/m^2 on 1.5 m^2; sums of a few thousand doubles.
        assert setup.scene.mass.sum() == pytest.approx(0.3, rel=1e-12)
        material = setup.scene.material
        assert (material.stretch_stiffness, material.shear_stiffness) == (500, 150)
    x = a.start.positions[0]
    assert np.ptp(x[2]) == 0
    assert np.ptp(x[0, a.pins]) == 1.0
    assert np.ptp(x[1, a.pins]) == 0
    x = b.start.positions[0]
    assert np.ptp(x[0, b.pins]) == 0
    assert np.ptp(x[2, b.pins]) == 1.0
    assert not c.pins.any()
    gap = np.linalg.norm(c.rest, axis=0).min() - RADIUS - c.scene.thickness
    assert gap == pytest.approx(DROP, abs=1e-12)  # a vertex lies over the centre
    assert abs(c.start.positions[0] - c.rest).max() <= WAVE


@pytest.mark.parametrize("name", NAMES)
def test_a_peer_has_our_masses_pins_and_start(peer: Callable[..., Peer], name: str) -> None:
    setup = build(name, 4)
    engine = peer(setup)
    np.testing.assert_allclose(engine.masses, setup.scene.mass, rtol=1e-12)
    for _ in range(2):
        # Single precision keeps 6e-8 of the 1.5 m.
        np.testing.assert_allclose(engine.state.positions, setup.start.positions, atol=1e-7)
        assert not engine.state.velocities.any()
        engine.advance(setup.controls)
        assert engine.taken[0] > 0
        assert engine.taken[1] >= 0
        x, v = engine.read()
        np.testing.assert_allclose(x[:, setup.pins], setup.start.positions[0][:, setup.pins], atol=1e-7)
        assert not v[:, setup.pins].any()
        assert abs(v[:, ~setup.pins]).max() > 0
        engine.reset(setup.start)


def test_a_peer_falls_freely(peer: Callable[..., Peer]) -> None:
    setup = build("C", 4)
    engine, frames, substeps = peer(setup, substeps=4), 4, 4
    for _ in range(frames):
        engine.advance(setup.controls)
    m, scene = setup.scene.material, setup.scene
    t, h = frames * scene.frame_dt, scene.frame_dt / substeps
    # Drag c: x = g (t / c - (1 - exp(-c t)) / c^2). First order in h: the velocity is late or early by g h at most.
    fallen = scene.gravity * (t / m.drag - (1 - np.exp(-m.drag * t)) / m.drag**2)
    sunk = (setup.start.positions[0, 2] - engine.state.positions[0, 2]).mean()
    assert sunk == pytest.approx(fallen, abs=scene.gravity * h * t)


@pytest.mark.parametrize("name", NAMES)
def test_explicit_taichi_computes_our_forces(name: str) -> None:
    if reason := peers.missing("Taichi"):
        pytest.skip(reason)
    setup = build(name, 4)
    ours, frames, errors = truth(setup), setup.frames(EARLY), []
    ours.reset(setup.start)
    for _ in range(frames):
        ours.advance(setup.controls)
    for refine in (4, 8):
        taichi: Any = peers.make(peers.setting("Taichi", {"method": "explicit", "refine": refine}), setup)
        for _ in range(frames):
            taichi.advance(setup.controls)
        errors.append(abs(taichi.state.positions - ours.state.positions).max())
    # Symplectic Euler tends to the same motion at first order in the step.
    assert errors[0] / errors[1] == pytest.approx(2, abs=0.2)
    assert errors[1] < 1e-3 * abs(ours.state.positions - setup.start.positions).max() + 1e-4


def test_xpbd_tends_to_our_truth() -> None:
    if reason := peers.missing("Taichi"):
        pytest.skip(reason)
    setup = build("A", 4)
    limp = setup.scene.material.with_changes(damping=0.0)  # it has no dashpots
    setup = replace(setup, scene=setup.scene.with_material(limp))
    true = follow(setup, truth(setup), seconds=EARLY).early
    errors = []
    for substeps in (20, 40, 80):
        engine = peers.make(peers.setting("Taichi", {"method": "xpbd", "substeps": substeps}), setup)
        errors.append(error_mm(follow(setup, engine, seconds=EARLY).early, true))
    # First order in the step: halves; 1.5 leaves room for the second. Steps below half a millisecond round.
    assert errors[1] < errors[0] / 1.5
    assert errors[2] < errors[1] / 1.5


def test_mujocos_shell_has_our_stiffness() -> None:
    if reason := peers.missing("MuJoCo"):
        pytest.skip(reason)
    from training.bench.peers.mujoco import MujocoCloth, sheet

    setup = build("A", 4)
    young, poisson, thickness = sheet(setup)
    membrane = young * thickness / (1 - poisson**2)
    assert membrane == pytest.approx(650, rel=1e-12)
    assert poisson * membrane == pytest.approx(150, rel=1e-12)
    assert young * thickness**3 / 12 / (1 - poisson**2) == pytest.approx(2e-5, rel=1e-12)
    # Moved along the threads by the strain e, a pinned sheet pulls back with 650 N/m (e + 3/2 e^2 + ...), St. Venant.
    engine, strain = MujocoCloth(setup, "membrane"), 1e-3
    x = setup.rest[1, engine.free] * strain
    engine.data.qpos[1::3] = x
    import mujoco

    mujoco.mj_forward(engine.model, engine.data)
    held = engine.data.qfrc_passive[1::3].reshape(-1, setup.scene.grid.cols)
    assert held[-1].sum() == pytest.approx(650 * strain * setup.scene.grid.width, rel=2 * strain)


class Broken:
    """A backend whose cloth is gone after two frames."""

    def __init__(self, backend: Backend) -> None:
        self._backend, self._frames = backend, 0

    def reset(self, *given: Any) -> None:
        self._frames = 0
        self._backend.reset(*given)

    def advance(self, controls: Controls) -> State:
        self._frames += 1
        state = self._backend.advance(controls)
        return state if self._frames < 2 else replace(state, positions=state.positions * np.nan)


def weaker(scene: Scene) -> Scene:
    return replace(scene, gravity=0.7 * scene.gravity)


def test_slow_motion_failures_and_long_runs_are_told() -> None:
    setup = build("A", 8)
    true = follow(setup, truth(setup))
    slow = follow(setup, truth(replace(setup, scene=weaker(setup.scene))))
    assert lag(setup, slow.late, true.late) > TOLERANCE
    assert lag(setup, true.late, true.late) == 0
    assert error_mm(slow.early, true.early) > 1
    assert 0 < p99(setup, true.late) < 0.05
    assert len(true.seconds) == setup.frames(LATE)
    broken = follow(setup, Broken(truth(setup)))  # type: ignore[arg-type]
    assert broken.failure == "non-finite at frame 2"
    assert broken.late is None
    assert np.isnan(error_mm(broken.early, true.early))
    assert np.isnan(lag(setup, broken.late, true.late))
    assert follow(setup, truth(setup), limit=0).failure == "stopped after 0 s, at frame 1"


def row(engine: str, ms: float, error: float, **changes: object) -> results.PeerRow:
    nan = float("nan")
    settings = '{"solver": "explicit"}' if engine == results.OWN else '{"method": "explicit"}'
    level = "avx2" if engine == results.OWN else ""
    base = results.PeerRow(
        "A", 3, 3, engine, settings, level, 1, 5, ms, ms, ms, ms, error, error, nan, nan, 0, nan, 0, 0, 0.01, 1, ""
    )
    return replace(base, **changes)  # type: ignore[arg-type]


def test_rivals_compare_at_no_larger_error_and_only_what_passes() -> None:
    fast, fine = row(results.OWN, 1, 2.0), row(results.OWN, 4, 0.5)
    asleep = row(results.OWN, 0.1, 0.1, lag=2 * TOLERANCE)
    coarse, good, best = (row("Taichi", ms, error) for ms, error in ((20, 3.0), (40, 1.0), (80, 0.1)))
    slow = row("Taichi", 0.1, 1.0, lag=-2 * TOLERANCE)
    other = row("Taichi", 30, 9.0, own_early_mm=1.5, lag=2 * TOLERANCE, own_lag=0.01)  # judged by its own truth
    rows = [fast, fine, asleep, coarse, good, best, slow, other]
    assert results.rivals(rows, "A", "avx2") == [(coarse, fast), (good, fine), (best, None), (other, fine)]
    assert "at least 7.5 x" in results.table(rows)
    assert "none of ours is as near" in results.table(rows)
    wide = replace(fine, instruction_set="avx512", ms=2.0)
    assert results.rivals([*rows, wide], "A", "avx512") == [(coarse, wide), (good, wide), (best, None), (other, wide)]
    assert "at least 10.0 x" in results.table([*rows, wide])
    # Below the chaos floor errors are equal.
    floor = [replace(r, floor_early_mm=0.6) for r in rows]
    assert results.rivals(floor, "A", "avx2")[2][1] == floor[1]


def test_end_to_end_without_any_peer(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(peers, "missing", lambda engine: "" if engine == results.OWN else f"{engine} is not installed")
    settings = [
        {"solver": "explicit", "refine": 1},
        {"solver": "admm", "iterations": 10},
        {"solver": "explicit", "refine": 2},
    ]
    monkeypatch.setitem(peers.SETTINGS, results.OWN, [settings[0], {}, {}, settings[2]])
    argv = ["--quick", "--budget", "0", "--out", str(tmp_path)]
    assert peers.BENCHMARK.main(argv) == 0
    text = capsys.readouterr().out
    assert "skipped: MuJoCo is not installed" in text
    assert "QUICK" in text
    rows = read_rows(tmp_path / "peers.csv", results.PeerRow)
    sets = peers.wide()
    assert [(r.scene, r.settings, r.instruction_set) for r in rows] == [
        (name, json.dumps(options), level) for name in NAMES for options in (settings[0], settings[2]) for level in sets
    ]
    for name, level in product(NAMES, sets):
        one, two = (r for r in rows if (r.scene, r.instruction_set) == (name, level))
        assert one.passed
        assert 0 < one.ms_q1 <= one.ms <= one.ms_q3
        # Between the first and the second order, of whole and half steps against a quarter: 1/3 and 1/5.
        assert 0.1 < two.early_mm / one.early_mm < 0.7
        assert one.frames == build(one.scene).frames(LATE)
    assert json.loads((tmp_path / "peers.json").read_text())["quick"] is True
    assert ElementTree.parse(tmp_path / "peers.svg").getroot().tag.endswith("svg")
    assert (tmp_path / "peers.png").stat().st_size > 10_000
    assert peers.BENCHMARK.main([*argv, "--scenes", "C", "--backend", 'miniature={"factor": 2}']) == 0
    assert "miniature factor=2" in capsys.readouterr().out
    again = read_rows(tmp_path / "peers.csv", results.PeerRow)
    assert str([r for r in again if r.scene != "C"]) == str([r for r in rows if r.scene != "C"])  # measured once


def test_what_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(peers, "find_spec", lambda name: None)
    assert "pip install" in peers.missing("MuJoCo")
    assert not peers.missing(results.OWN)
    assert find("peers") is peers.BENCHMARK
    with pytest.raises(ValueError, match="'A', 'B', 'C'"):
        peers.BENCHMARK.main(["--scenes", "D"])
