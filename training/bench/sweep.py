"""Where solvers fail: stiffness, mass, frame and wind far from the scene's own, from the episode's start."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from tqdm import tqdm

from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from training.bench.configurations import Config, label
from training.bench.cost import build
from training.bench.truth import Case, Truth, load, retime
from training.bench.verdict import MARKS, TRUTH, judge, trajectory
from training.rows import Store

DURATION = 0.64  # s, a whole number of frames of four times any scene's
COARSE = 2  # grids of half the resolution
AXES: dict[str, tuple[float, ...]] = {
    "stiffness": (1 / 4, 1 / 2, 1, 2, 4, 8, 16),
    "mass": (1 / 3, 1 / 2, 1, 2, 3),
    "frame": (1 / 2, 1, 2, 4),
    "wind": (0, 1, 2, 3),
}


@dataclass(frozen=True)
class Cell:
    """One solver in one world: where, and the fields of ``Verdict``."""

    scene: str
    solver: str
    options: str
    axis: str
    factor: float
    seed: int
    truth: str
    outcome: str
    detail: str
    ms: float
    p99: float
    p99_truth: float
    kinetic: float
    kinetic_truth: float
    height: float
    error: float


KEY = ("scene", "solver", "options", "axis", "factor", "seed", "truth")


def world(truth: Truth, axis: str, factor: float, frames: int) -> tuple[Scene, list[Controls]]:
    """The truth's scene and controls, changed by ``factor`` along ``axis``.

    All stiffnesses are scaled, with the dashpots' constants kept (``damping`` is a time and scales inversely).
    """
    scene, m = truth.scene, truth.scene.material
    controls = truth.controls[:frames]
    if axis == "stiffness":
        stiff = {n: getattr(m, n) * factor for n in ("stretch_stiffness", "shear_stiffness", "bend_stiffness")}
        scene = scene.with_material(m.with_changes(**stiff, damping=m.damping / factor))
    elif axis == "mass":
        scene = scene.with_material(m.with_changes(areal_density=m.areal_density * factor))
    elif axis == "frame":
        controls = retime(scene, truth.states[0], controls, factor)
        scene = replace(scene, frame_dt=scene.frame_dt * factor)
    elif scene.wind is not None:
        controls = [replace(c, wind=c.wind * factor) for c in controls]
        scene = replace(scene, wind=replace(scene.wind, max_speed=scene.wind.max_speed * max(factor, 1)))
    return scene, controls


def cells(cases: Sequence[Case], ends: bool) -> list[tuple[Case, str, float]]:
    """Every world; wind only where it blows, and the unchanged one once. ``ends`` takes those of the axes only."""
    out = []
    for case in cases:
        windy = case.world().scene.wind is not None
        for axis, factors in AXES.items():
            if axis != "wind" or windy:
                chosen = [factors[0], factors[-1]] if ends else factors
                out += [(case, axis, f) for f in chosen if f != 1 or axis == "stiffness"]
    return out


def run(
    store: Store[Cell], cases: Sequence[Case], configs: Sequence[Config], cache: Path, *, ends: bool = False
) -> None:
    """Fill in what ``store`` lacks. The truth of a cell is explicit in float64 at half the stable step."""
    todo = cells(cases, ends)
    with tqdm(total=len(todo) * len(configs), desc="sweep", disable=None) as bar:
        for case, axis, factor in todo:
            frames = round(DURATION / case.world().scene.frame_dt)
            recorded = load(case, frames, [0], cache)
            missing = [
                c for c in configs if (case.scene, c.solver, c.text, axis, factor, case.seed, recorded.key) not in store
            ]
            bar.update(len(configs) - len(missing))
            if not missing:
                continue
            scene, controls = world(recorded, axis, factor, frames)
            start = recorded.states[0]
            exact = build(TRUTH, scene)
            true: list[State] = [] if isinstance(exact, str) else trajectory(exact, scene, start, controls)[0]
            for config in missing:
                bar.set_postfix_str(f"{case.scene} {axis} x{factor:.2g} {label(config.solver, config.text)}")
                bar.update()
                verdict = judge(config, scene, start, controls, true, seed=case.seed)
                store.add(
                    Cell(
                        scene=case.scene,
                        solver=config.solver,
                        options=config.text,
                        axis=axis,
                        factor=factor,
                        seed=case.seed,
                        truth=recorded.key,
                        **asdict(verdict),
                    )
                )


def _mark(cell: Cell) -> str:
    return MARKS[cell.outcome] * (2 if cell.outcome in ("slow", "fast") and cell.height > 0.2 else 1)


def table(rows: Sequence[Cell]) -> str:
    """A letter a cell, doubled where the mean height is off by over 20 %; in words those that did not survive."""
    factors = {axis: [f for f in AXES[axis] if f != 1 or axis == "stiffness"] for axis in AXES}
    legend = ", ".join(f"{mark} {name}" for name, mark in MARKS.items()) + "; doubled: by over 20 %"
    lines = [legend, f"{'':34s}" + "".join(f"{axis:>{5 * len(factors[axis])}s}  " for axis in AXES)]
    heads = (" ".join(f"{f'{f:.2g}':>4s}" for f in factors[axis]) for axis in AXES)
    lines.append(f"{'':35s}" + "   ".join(heads))
    found = {(r.scene, r.solver, r.options, r.axis, r.factor): r for r in rows}
    for scene, solver, options in dict.fromkeys((r.scene, r.solver, r.options) for r in rows):
        parts = []
        for axis, values in factors.items():
            marks = (found.get((scene, solver, options, axis, f)) for f in values)
            parts.append(" ".join(f"{_mark(m) if m else '':>4s}" for m in marks))
        lines.append(f"{scene:10s} {label(solver, options):24s}" + "   ".join(parts))
    for r in rows:
        if r.outcome in ("failed", "refused", "strained", "lively"):
            lines.append(f"{r.scene} {label(r.solver, r.options)}, {r.axis} x{r.factor:.2g}: {r.outcome}, {r.detail}")
    return "\n".join(lines)
