"""``minicloth bench stability``: the instrument can fail, goes on where it stopped; worlds are what they say."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from cloth_envs.physics.explicit.solver import ExplicitSolver
from cloth_envs.registry import SCENES
from cloth_envs.state import Controls, State
from training.bench.benchmark import MEASURED, find
from training.bench.measure import built
from training.bench.participants import FAMILIES, STABILITY
from training.bench.stability import run as stability
from training.bench.stability.rows import Score, StabilityRow, marks
from training.bench.stability.run import worlds
from training.bench.stability.runs import HEIGHT, Run, pierced, run, score, truths
from training.bench.stability.worlds import AXES, LENGTHS, Base, Stage, driven, episode, shot
from training.rows import read_rows
from training.truth import DETAILED, Case, unseen

main = find("stability").main
EXPLICIT = FAMILIES["explicit"][0]


class Ghost:
    """No physics: the cloth stays, but for what is driven; bodies pass through it."""

    def __init__(self, stage: Stage) -> None:
        self.stage = stage

    def reset(self, state: State, materials: None = None) -> None:
        self.state = state.copy()

    def advance(self, controls: Controls) -> State:
        self.state = driven(self.stage.scene, self.state, controls)
        return self.state


class Replay:
    """The states of a run, ``aside`` [m] along an axis."""

    def __init__(self, true: Run, aside: float | np.ndarray, axis: int = 1) -> None:
        self.states, self.aside, self.axis = true.states, aside, axis

    def reset(self, state: State, materials: None = None) -> None:
        self.frame = 0

    def advance(self, controls: Controls) -> State:
        self.frame += 1
        state = self.states[self.frame].copy()
        state.positions[:, self.axis] += self.aside
        return state


def scored(backend: Any, stage: Stage, found: tuple[Run, Run] | None = None) -> Score:
    return score(run(backend, stage), *(found or truths(stage, 0)), len(stage.controls))


@pytest.fixture(scope="module")
def curtain() -> Stage:
    return AXES["stiffness"].make(Base("Curtain", 300, 4), 1.0)


@pytest.fixture(scope="module")
def true(curtain: Stage) -> tuple[Run, Run]:
    return truths(curtain, 0)


def test_explicit_passes(curtain: Stage, true: tuple[Run, Run]) -> None:
    found = scored(built(EXPLICIT, curtain.scene), curtain, true)
    assert not found.reason
    assert found.failed_at == pytest.approx(0.64)
    assert found.gate < HEIGHT
    # The truth's step is half as long: first-order errors of both are alike.
    assert found.p99 == pytest.approx(found.p99_truth, rel=0.1)


def test_too_long_a_step_is_a_blow_up(curtain: Stage, true: tuple[Run, Run]) -> None:
    solver = ExplicitSolver(curtain.scene)
    solver_reset = solver.reset

    def reset(state: State, materials: None = None) -> None:
        solver_reset(state)
        solver._cuts[..., 0] //= 8  # the bound is sharp to 0.9, so even blown up frames get too few

    solver.reset = reset  # type: ignore[method-assign, assignment]
    found = scored(solver, curtain, true)
    assert found.reason == "blow-up"
    assert 0 < found.failed_at < 0.64


def test_a_frozen_cloth_is_caught_by_the_height_gate() -> None:
    drop = AXES["actions"].make(Base("BallDrop", 300, 4), 0.0)
    found = scored(Ghost(drop), drop)
    assert found.reason == "slow motion"
    assert found.gate == pytest.approx(1, abs=0.05)  # all of the way is missing


def test_a_shifted_copy_is_caught_by_the_error(curtain: Stage, true: tuple[Run, Run]) -> None:
    aside = 0.06 * curtain.scene.grid.length
    found = scored(Replay(true[0], aside), curtain, true)
    assert found.reason == "error"
    assert found.error == pytest.approx(0.06, rel=1e-4)
    assert found.gate == pytest.approx(0, abs=1e-9)
    assert not scored(Replay(true[0], 0.6 * aside), curtain, true).reason


def test_rows_that_part_and_meet_are_strained(curtain: Stage, true: tuple[Run, Run]) -> None:
    """Rows by turns a twentieth of their distance higher and lower: edges a tenth too long, no vertex far off."""
    grid = curtain.scene.grid
    up = 0.05 * grid.row_spacing * np.where(np.arange(grid.rows) % 2, -1, 1)[:, None]  # 0 on the mean of the areas
    found = scored(Replay(true[0], up, axis=2), curtain, true)
    assert found.reason == "strained"
    assert found.p99 == pytest.approx(0.1, abs=0.03)  # the curtain's own strain is 1 %
    assert not scored(Replay(true[0], 0.3 * up, axis=2), curtain, true).reason


def test_a_ball_that_passes_through_is_counted() -> None:
    """Slow or fast, and thinner than a cell: the frozen cloth is not in its way. Explicit stops what is no thinner."""
    for speed, radius in ((2.0, 0.2), (30.0, 0.2), (4.0, 0.01)):
        stage = shot(Base("Collision", 300, 4), speed=speed, radius=radius)
        found = scored(Ghost(stage), stage)
        assert found.reason == "tunnelling"
        assert found.tunnelled > 0
    stage = shot(Base("Collision", 300, 4), speed=2.0, radius=0.2)
    held = scored(built(EXPLICIT, stage.scene), stage)
    assert not held.reason
    assert held.tunnelled == 0


def test_a_pierced_triangle_by_hand() -> None:
    stage = shot(Base("Collision", 300, 4), speed=1.0, radius=0.01)
    scene, state = stage.scene, stage.start.copy()
    corners = state.positions[0].reshape(3, -1).T[scene.grid.triangles[40]].astype(float)
    middle, normal = corners.mean(0), np.cross(corners[1] - corners[0], corners[2] - corners[0])
    step = 1e-3 * normal / np.linalg.norm(normal)
    before, after = state.copy(), state.copy()
    before.colliders[:], after.colliders[:] = middle - step, middle + step
    assert pierced(scene, before, after) == 1
    assert pierced(scene, after, before) == 1
    assert pierced(scene, before, before) == 0
    # With the cloth moving as fast as the ball nothing is pierced.
    after.positions += (2 * step)[:, None, None].astype(np.float32)
    assert pierced(scene, before, after) == 0


def test_momentum_from_nowhere_is_told() -> None:
    stage = AXES["free"].make(Base("Curtain", 300, 4), 5.0)

    class Pushed(Ghost):
        def advance(self, controls: Controls) -> State:
            self.state = super().advance(controls)
            self.state.velocities[:, 0] += 0.01 * scale
            return self.state

    scale = np.average(np.linalg.norm(stage.start.velocities[0], axis=0), weights=stage.scene.grid.areas)
    found = scored(Pushed(stage), stage)
    assert found.reason == "momentum"
    assert found.momentum == pytest.approx(0.05, rel=1e-3)
    kept = scored(built(EXPLICIT, stage.scene), stage)
    assert not kept.reason
    assert kept.momentum < 1e-5  # single precision, some hundred substeps


def test_other_worlds_are_told_by_their_reasons() -> None:
    """Explicit in another world than that of the truth."""
    flag = AXES["mass"].make(Base("Flag", 0, 4), 1 / 3)
    true = truths(flag, 0)

    def other(**changes: Any) -> Score:
        return scored(built(EXPLICIT, replace(flag.scene, **changes)), flag, true)

    assert other(gravity=3.0).reason == "slow motion"
    assert other(gravity=15.0).reason == "fast motion"
    snapped = other(material=flag.scene.material.with_changes(stretch_stiffness=0.01))
    assert snapped.reason == "overstretch"
    assert "in frame" in snapped.detail


def test_the_miniature_is_measured_as_agents_meet_it() -> None:
    """At every factor, with nothing but the factor given."""
    plain = {p.label: p.whole for p in STABILITY}
    assert [plain[f"mini \u00d7{n}"] for n in (2, 3, 4)] == [{"factor": n} for n in (2, 3, 4)]
    assert len({(p.backend, str(p.whole)) for p in STABILITY}) == len(plain)  # nothing twice


def test_a_refusal_keeps_its_words(curtain: Stage, true: tuple[Run, Run]) -> None:
    refused = built(replace(EXPLICIT, options={"substeps": 1}), curtain.scene)
    found = scored(refused, curtain, true)
    assert found.reason == "refused"
    assert "use at least" in found.detail
    assert found.failed_at == 0


def test_controls_need_no_cloth() -> None:
    """Those of the kinematic script are what the task gives while the truth runs."""
    for scene in SCENES:
        true = Case(scene, 300, coarse=8, sequence=unseen(scene)).record(3, [0])
        script = episode(Base(scene, 300, 8), 3)
        np.testing.assert_array_equal(script.start.positions, true.states[0].positions)
        for a, b in zip(script.controls, true.controls, strict=True):
            for name, value in vars(b).items():
                np.testing.assert_allclose(getattr(a, name), value, atol=1e-12, err_msg=f"{scene} {name}")


def test_worlds_are_what_they_say() -> None:
    base = Base("Flag", 300, 8)
    plain = episode(base, 16)
    for level in (0.5, 3.0):
        assert AXES["frame"].make(base, level).scene.frame_dt == pytest.approx(0.04 * level)
    stiff = AXES["stiffness"].make(base, 16.0).scene.material
    was = plain.scene.material
    assert stiff.shear_stiffness == 16 * was.shear_stiffness
    assert stiff.damping * stiff.stretch_stiffness == pytest.approx(was.damping * was.stretch_stiffness)
    blown = AXES["wind"].make(base, 3.0)
    np.testing.assert_allclose(blown.controls[4].wind, 3 * plain.controls[4].wind)
    turned = AXES["direction"].make(base, 180.0)
    np.testing.assert_allclose(turned.controls[4].wind, -plain.controls[4].wind, atol=1e-12)
    assert AXES["resolution"].make(base, 2.0).scene.grid.shape == (9, 13)
    ball = shot(Base("Collision", 300, 8), speed=8.0, radius=0.1)
    way = ball.controls[1].colliders[0, 0, 0] - ball.controls[0].colliders[0, 0, 0]
    np.testing.assert_allclose(way, [0, 8 * ball.scene.frame_dt, 0], atol=1e-12)
    assert ball.controls[-1].colliders[0, 0, 0, 1] == pytest.approx(0.3)
    assert len(worlds(None, list(AXES), range(5), ends=False)) > 300
    detailed = [world for world in worlds(None, ["mass"], (300, 301), ends=True) if world[2] in DETAILED]
    assert {(scene, seed) for _, _, scene, seed in detailed} == {(scene, 300) for scene in DETAILED}
    assert episode(Base("Draping", 300, 4), 1).scene.grid.shape == (28, 27)
    wild = AXES["bang-bang"].make(base, 30.0)
    assert [len(c.handle_positions) for c in wild.controls] == [1] * 30
    assert list(AXES["bang-bang"].of(None)) == [*MEASURED, *DETAILED]
    assert AXES["bang-bang"].levels[-1] == 200
    assert {scene for _, _, scene, _ in worlds(["BallDrop"], list(AXES), [0], ends=True)} == {"BallDrop"}


def test_quick_run_end_to_end_and_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    few = [p for p in STABILITY if p.label in ("explicit", "mini \u00d74 similar")]
    monkeypatch.setattr(stability, "STABILITY", [*few, replace(EXPLICIT, options={"substeps": 1}, name="one step")])
    out, images = tmp_path / "out", tmp_path / "images"
    argv = ["--quick", "--scenes", "Flag", "--axes", "mass,wind,length", "--out", str(out), "--images", str(images)]
    argv += ["--backend", 'reference={"solver": "admm"}']
    assert main(argv) == 0
    text = capsys.readouterr().out
    assert "QUICK" in text
    assert json.loads((out / "stability.json").read_text())["quick"] is True
    rows = read_rows(out / "stability.csv", StabilityRow)
    assert len(rows) == 4 * (2 + 2 + len(LENGTHS))
    found = marks(rows)
    assert found["mass", "explicit", 1 / 3].score == 1
    assert ("mass", "reference solver=admm", 1 / 3) in found
    refused = found["wind", "one step", 3.0]
    assert (refused.score, refused.reason) == (0, "refused")
    assert ElementTree.parse(images / "stability.svg").getroot().tag.endswith("svg")
    assert (images / "stability.png").stat().st_size > 10_000
    # Nothing is measured twice; the chart comes from the rows alone.
    monkeypatch.setattr(stability, "rows_of", None)
    assert main(argv) == 0
    assert str(read_rows(out / "stability.csv", StabilityRow)) == str(rows)
    assert main(["--chart-only", "--out", str(out), "--images", str(images)]) == 0
    with pytest.raises(ValueError, match="--fresh"):
        main(["--out", str(out)])


def test_marks_count_what_is_wrong_half(curtain: Stage) -> None:
    fields: dict[str, Any] = dict.fromkeys(StabilityRow.__dataclass_fields__, 0) | {
        "axis": "mass",
        "backend": "b",
        "level": 1.0,
    }
    fields["truth"] = ""
    rows = [StabilityRow(**{**fields, "seed": i, "reason": reason}) for i, reason in enumerate(
        ("", "slow motion", "slow motion", "blow-up")
    )]  # fmt: skip
    (mark,) = marks(rows).values()
    assert (mark.passed, mark.survived, mark.runs, mark.reason) == (1, 3, 4, "blow-up")
    assert mark.reasons == "slow motion 2, blow-up 1"
    assert mark.score == 0.5
    assert marks(rows[:3])["mass", "b", 1.0].reason == "slow motion"


def test_mistakes_name_the_nearest() -> None:
    with pytest.raises(ValueError, match="Did you mean 'Flag'"):
        main(["--scenes", "Flagg"])
    with pytest.raises(ValueError, match="Did you mean 'mass'"):
        main(["--axes", "masss"])
    with pytest.raises(ValueError, match="--out"):
        main(["--chart-only"])
