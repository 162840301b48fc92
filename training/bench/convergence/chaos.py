"""The chaos floor: how far the truth parts from itself when every vertex is nudged by a millionth of the cloth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tqdm import tqdm

from cloth_envs.state import State
from training.bench.truth import Case, length, mean_height, record, vertex_error
from training.rows import Store, read_rows

NUDGE = 1e-6  # of the cloth's length, in a random direction at every vertex that is not a handle
FRAMES = (1, 5, 10, 25, 50)
SETTLE = 1.0  # s of the episode before the nudge
DATA = Path(__file__).parents[3] / "docs" / "data" / "chaos_floor.csv"


@dataclass(frozen=True)
class Floor:
    """What became of the nudge after ``frames``, over the cloth's longer side: ``error`` is the mean distance of the
    vertices, ``height`` the difference of the mean height, without its sign.
    """

    scene: str
    rows: int
    cols: int
    seed: int
    frames: int
    seconds: float
    error: float
    error_m: float
    height: float


def nudged(state: State, handles: tuple[int, ...], size: float, rng: np.random.Generator) -> State:
    """``state`` with its free vertices moved by ``size`` [m] in random directions."""
    out = state.copy()
    push = rng.normal(size=out.positions.shape)
    push *= size / np.linalg.norm(push, axis=1, keepdims=True)
    push.reshape(*push.shape[:2], -1)[..., list(handles)] = 0.0
    out.positions += push
    return out


def measure(case: Case, frames: tuple[int, ...] = FRAMES) -> list[Floor]:
    """One seed: the truth and its nudged copy side by side under the truth's controls."""
    world = case.world()
    settle = round(SETTLE / world.scene.frame_dt)
    scene, states, controls = record(case, settle + max(frames), [settle, *(settle + f for f in frames)])
    world.backend.reset(nudged(states[settle], scene.handles, NUDGE * length(scene), np.random.default_rng(case.seed)))
    found = []
    for frame, control in enumerate(controls[settle:], 1):
        state = world.backend.advance(control)
        if frame in frames:
            error = vertex_error(scene, state, states[settle + frame])
            height = abs(mean_height(scene, state) - mean_height(scene, states[settle + frame])) / length(scene)
            seconds, metres = frame * scene.frame_dt, error * length(scene)
            found.append(Floor(case.scene, *scene.grid.shape, case.seed, frame, seconds, error, metres, height))
    return found


def run(store: Store[Floor], cases: list[Case], frames: tuple[int, ...] = FRAMES) -> None:
    """Measure the cases that ``store`` lacks."""
    for case in tqdm(cases, desc="chaos floor", disable=None):
        if not all((case.scene, *case.world().scene.grid.shape, case.seed, f) in store for f in frames):
            for row in measure(case, frames):
                store.add(row)


KEY = ("scene", "rows", "cols", "seed", "frames")


def floor(scene: str, frames: float, *, quantile: float = 0.5, path: Path = DATA) -> float:
    """Error that the smallest of differences grows to after ``frames``, over the cloth's longer side.

    The quantile over the seeds, interpolated between the measured frames on logarithmic axes; at the scene's own
    resolution. An error claimed after ``frames`` frames means nothing below it.

    Raises:
        ValueError: not measured for this scene, or for so many frames.
        FileNotFoundError: no data; `minicloth bench solvers --parts chaos` makes them.
    """
    if not path.is_file():
        raise FileNotFoundError(f"no chaos floor in {path}: run `minicloth bench solvers --parts chaos --out FOLDER`")
    rows = [row for row in read_rows(path, Floor) if row.scene == scene]
    known = sorted({row.frames for row in rows})
    if not known or not known[0] <= frames <= known[-1]:
        raise ValueError(f"the chaos floor of {scene!r} is known at frames {known}, not at {frames}")
    at = [np.quantile([row.error for row in rows if row.frames == f], quantile) for f in known]
    return float(np.exp(np.interp(np.log(frames), np.log(known), np.log(at))))


def table(rows: list[Floor]) -> str:
    """Median and range over the seeds, in % of the cloth's length."""
    frames = sorted({row.frames for row in rows})
    lines = [f"{'scene':10s} {'seeds':>5s}" + "".join(f"{f'{f} fr.':>27s}" for f in frames)]
    for scene in dict.fromkeys(row.scene for row in rows):
        line = f"{scene:10s} {len({row.seed for row in rows if row.scene == scene}):5d}"
        for f in frames:
            found = [100 * row.error for row in rows if row.scene == scene and row.frames == f]
            line += f"{f'{np.median(found):.2g} ({min(found):.2g}-{max(found):.2g})':>27s}" if found else " " * 27
        lines.append(line)
    return "\n".join(lines)
