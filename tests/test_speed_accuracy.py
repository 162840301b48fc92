"""``minicloth bench speed-accuracy``: it works end to end, goes on where it stopped, and can fail."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar
from xml.etree import ElementTree

import numpy as np
import pytest

from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from training.bench.baselines import Extrapolation, Oracle, fractional
from training.bench.benchmark import find
from training.bench.clock import CostRow, costs
from training.bench.measure import Windows, errors, failed_by, gather
from training.bench.participants import FAMILIES, Participant, label, truth
from training.bench.speed_accuracy.rows import GATE, SpeedAccuracyRow, front, gates, summaries
from training.rows import read_rows
from training.truth import Case

main = find("speed-accuracy").main
EXPLICIT, (REPEAT,) = FAMILIES["explicit"][0], FAMILIES["repeat last frame"]


@pytest.fixture(scope="module")
def cases() -> list[Case]:
    return [Case("Flag", seed, coarse=8, truth="fine") for seed in (200, 201)]


@pytest.fixture(scope="module")
def windows(cases: list[Case], tmp_path_factory: pytest.TempPathFactory) -> Windows:
    return gather(cases, (2, 5), 10, range(16), tmp_path_factory.mktemp("cache"))


@pytest.fixture(scope="module")
def episodes(cases: list[Case], tmp_path_factory: pytest.TempPathFactory) -> Windows:
    return gather(cases, (0,), 13, range(14), tmp_path_factory.mktemp("cache"))  # frames of half a second


class Shifted:
    """The truth, 3 cm to the side."""

    def __init__(self, scene: Scene, *, num_envs: int, truth: Sequence[State] = ()) -> None:
        self.frame, self.truth = 0, truth

    def reset(self, state: State, materials: None = None) -> None:
        self.frame = 0

    def advance(self, controls: Controls) -> State:
        self.frame += 1
        now = self.truth[self.frame]
        return State(**{**now.arrays(), "positions": now.positions + np.array([0.0, 0.03, 0.0])[:, None, None]})


class Unstable:
    """Twice as far from where it was at every frame."""

    def __init__(self, scene: Scene, *, num_envs: int) -> None:
        pass

    def reset(self, state: State, materials: None = None) -> None:
        self.state = state.copy()

    def advance(self, controls: Controls) -> State:
        self.state = State(**{**self.state.arrays(), "positions": 2 * self.state.positions})
        return self.state


class Frozen(Unstable):
    """A solver that does nothing."""

    def advance(self, controls: Controls) -> State:
        return self.state


class Refusing(Unstable):
    """It finds out late."""

    def reset(self, state: State, materials: None = None) -> None:
        raise ValueError("no such cloth: use at least another")


SHIFTED, UNSTABLE, FROZEN, REFUSING = (
    Participant(kind.__name__, f"{__name__}:{kind.__name__}") for kind in (Shifted, Unstable, Frozen, Refusing)
)


def test_a_shifted_copy_is_off_by_the_shift(windows: Windows) -> None:
    percent = 100 * 0.03 / windows.scene.grid.length
    for row in errors(SHIFTED, windows, horizons=(1, 10)):
        # Five digits are kept.
        assert [row.error_mean, row.error_p95, row.error_max] == pytest.approx([percent] * 3, rel=1e-5)
        assert row.max_dx == pytest.approx(0.03, rel=1e-5)
        assert row.normal_deg == pytest.approx(0, abs=1e-5)
        assert not row.failure


def test_a_frozen_cloth_is_caught(windows: Windows, episodes: Windows) -> None:
    """It has the error of the last frame repeated, and the height gate tells that it does not fall."""
    frozen, repeat = (errors(m, windows, horizons=(1, 10)) for m in (FROZEN, REPEAT))
    for a, b in zip(frozen, repeat, strict=True):
        assert [a.error_mean, a.error_max, a.vmse, a.psnr] == [b.error_mean, b.error_max, b.vmse, b.psnr]
        assert a.error_mean > 0
    explicit, still = (gates(m, episodes) for m in (EXPLICIT, FROZEN))
    assert all(row.gate <= GATE for row in explicit)
    assert all(row.gate > 5 * GATE for row in still)  # all of a flag's way is missing


def test_an_unstable_method_is_reported(windows: Windows, episodes: Windows) -> None:
    """Edges double at every frame: a stretched one is over twice its length after the first."""
    rows = errors(UNSTABLE, windows, horizons=(1, 10))
    assert {row.failure for row in rows} == {"2 of 2: overstretch at frame 1"}
    assert all(np.isnan(row.error_mean) for row in rows)
    assert all(row.gate == np.inf and row.failure for row in gates(UNSTABLE, episodes))
    assert failed_by("overstretch at frame 2", 2)
    assert not failed_by("overstretch at frame 2", 1)
    (whole,) = summaries([row for row in rows if row.frames == 10], [], [])
    assert whole.failure == "4 of 4: overstretch at frame 1"
    assert not whole.passes
    for refused in (replace(EXPLICIT, options={"substeps": 1}), REFUSING):
        assert "use at least" in errors(refused, windows, horizons=(1,))[0].failure
        assert "use at least" in costs([refused], windows)[0].failure


class Noting(Frozen):
    """It tells where it was started."""

    starts: ClassVar[list[bytes]] = []

    def reset(self, state: State, materials: None = None) -> None:
        super().reset(state)
        Noting.starts.append(state.positions.tobytes())


def test_times_are_of_all_windows_in_turn(windows: Windows) -> None:
    """All starts of a seed first; frames of crumpled cloth take longer than those of a flat one."""
    participant = Participant("Noting", f"{__name__}:Noting")
    (row,) = costs([participant], windows, runs=4, run_ms=0)
    every = [windows.truth[0].select([i]).positions.tobytes() for i in (0, 2, 1, 3)]
    assert windows.starts == (2, 2, 5, 5)
    assert list(dict.fromkeys(Noting.starts[2:])) == every  # after it was built and warmed up
    assert row.runs == 4


def test_the_floor_is_what_a_nudge_does(episodes: Windows) -> None:
    floor = errors(truth("fine"), episodes, horizons=(1,))
    # 1e-6 of the length, and it has hardly grown or shrunk in one frame.
    assert all(1e-6 < row.error_mean < 1e-3 for row in floor)


def test_extrapolations_by_hand(windows: Windows) -> None:
    start = windows.truth[0]
    for moving in (False, True):
        method = Extrapolation(windows.scene, moving=moving)
        method.reset(start)
        for control in windows.controls[:3]:
            state = method.advance(control)
        expected = start.positions + moving * 3 * windows.scene.frame_dt * start.velocities
        np.testing.assert_allclose(state.positions, expected, atol=1e-5)
        np.testing.assert_array_equal(state.colliders, windows.controls[2].colliders)
    # The oracle is exact where the coarse grid has a vertex, and knows the truth at every frame.
    oracle = Oracle(windows.scene, truth=windows.truth)
    oracle.reset(start)
    for frame in (1, 2):
        coarse = (..., slice(None, None, 2), slice(None, None, 2))
        state = oracle.advance(windows.controls[frame - 1])
        np.testing.assert_allclose(state.positions[coarse], windows.truth[frame].positions[coarse], atol=1e-12)


def test_a_fractional_miniature_is_the_miniature_without_whole_factors(windows: Windows) -> None:
    """At factor 2 both do the same."""
    states: list[Any] = []
    for made in (
        fractional(windows.scene, num_envs=4, factor=2),
        FAMILIES["miniature similar"][1].build(windows.scene, 4),
    ):
        made.reset(windows.truth[0])
        for control in windows.controls[:2]:
            state = made.advance(control)
        states.append((state.positions, state.velocities))
    for a, b in zip(*states, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-6)


def test_front_leaves_out_what_fails() -> None:
    fields = dict.fromkeys(SpeedAccuracyRow.__dataclass_fields__, 0.0) | {"scene": "Flag", "options": "{}", "frames": 5}

    def row(family: str, ms: float, error: float, failure: str = "", gate: float = 0.0) -> SpeedAccuracyRow:
        own = {"family": family, "ms_median": ms, "error": error, "failure": failure, "gate": gate, "floor": 1e-3}
        return SpeedAccuracyRow(**{**fields, **own})  # type: ignore[arg-type]

    slow_good, fast_bad, worse = row("explicit", 4, 0.01), row("miniature similar", 1, 1.0), row("admm", 5, 0.5)
    late, broken, deep = row("admm", 0.5, 0.1, gate=0.2), row("seed", 0.1, 0.1, "1 of 2"), row("explicit", 9, 1e-4)
    deeper = row("explicit", 20, 1e-5)  # both are below the chaos floor: no closer
    assert front([slow_good, fast_bad, worse, late, broken, deep, deeper]) == [fast_bad, slow_good, deep]


def test_quick_run_end_to_end_and_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, images = tmp_path / "out", tmp_path / "images"
    argv = ["--quick", "--scenes", "Flag", "--families", "explicit,miniature similar,oracle coarse,repeat last frame"]
    argv += ["--backend", 'reference={"solver": "admm"}', "--backend", f"{__name__}:Frozen"]
    argv += ["--out", str(out), "--images", str(images), "--cache", str(tmp_path / "c")]
    assert main(argv) == 0
    text = capsys.readouterr().out
    assert "QUICK" in text
    assert "miniature similar x4" in text
    about = json.loads((out / "speed_accuracy.json").read_text())
    assert about["quick"] is True
    assert about["seeds"] == [1500, 1501]
    tables = {path.name: path.read_text() for path in out.glob("*.csv")}
    assert len(tables) == 5
    rows = read_rows(out / "speed_accuracy.csv", SpeedAccuracyRow)
    at = {(r.family, r.options, r.frames): r for r in rows}
    coarse, fine = (at["explicit", options, 5] for options in ("{}", '{"refine": 4}'))
    assert fine.error < 0.5 * coarse.error  # first order: a quarter
    assert coarse.ms_q1 <= coarse.ms_median <= coarse.ms_q3
    mini = at["miniature similar", '{"factor": 4}', 5]
    assert mini.skill == 0
    assert mini.error > at["oracle coarse", '{"factor": 4}', 5].error
    assert 0 < mini.upscale_ms < mini.ms_median
    # What --backend named takes part as any other.
    assert at["reference", '{"solver": "admm"}', 5].error > coarse.error
    frozen, repeated = (at[name, "{}", 5].error for name in (f"{__name__}:Frozen", "repeat last frame"))
    assert frozen == pytest.approx(repeated, rel=1e-5)  # rounded to single precision and to five digits
    cost_rows = read_rows(out / "speed_accuracy_cost.csv", CostRow)
    assert len(cost_rows) == len(at) // 4 - 3  # all but the oracle's two and the chaos floor
    # Nothing is measured twice; the charts come from the rows alone.
    for name in ("speed_accuracy", "speed_accuracy_flag"):
        assert ElementTree.parse(images / f"{name}.svg").getroot().tag.endswith("svg")
        (images / f"{name}.png").unlink()
    assert main(argv) == 0
    assert {path.name: path.read_text() for path in out.glob("*.csv")} == tables
    assert main(["--chart-only", "--out", str(out), "--images", str(images)]) == 0
    for name in ("speed_accuracy", "speed_accuracy_flag"):
        assert (images / f"{name}.png").stat().st_size > 10_000
    with pytest.raises(ValueError, match="--fresh"):
        main(["--out", str(out)])


def test_mistakes_name_the_nearest() -> None:
    with pytest.raises(ValueError, match="Did you mean 'Flag'"):
        main(["--scenes", "Flagg"])
    with pytest.raises(ValueError, match="Did you mean 'explicit'"):
        main(["--families", "explicitt"])
    with pytest.raises(ValueError, match="--out"):
        main(["--chart-only"])
    assert label("miniature similar", '{"factor": 1.5}') == "miniature similar x1.5"
    assert summaries([], [], []) == []
