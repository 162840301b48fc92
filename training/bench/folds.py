"""``minicloth bench folds``: what a sheet looks like at rest on grids of rising resolution, and which its folds need.

A square metre lies over the ball of BallDrop or hangs by the corner of Hanging, from the same smooth, slightly waved
start on every grid, and comes to rest in air that slows it. Folds are chaotic: where they lie differs from start to
start, how many and how large they are does not.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import find_peaks

from cloth_envs.folds import bending_length
from cloth_envs.grid import Grid
from cloth_envs.material import FABRICS
from cloth_envs.physics.explicit.solver import ExplicitSolver
from cloth_envs.physics.laws.diagnostics import strains
from cloth_envs.physics.laws.sheet import bend_energy
from cloth_envs.progress import progress
from cloth_envs.registry import load_task
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from training.bench.benchmark import Benchmark, Part, RowFile, Session
from training.rows import rounded

SIZES: tuple[int, ...] = (33, 65, 129, 193)  # vertices along a side; the finest from the first start only
USED: tuple[str, ...] = ("silk", "default", "denim")
SEEDS: tuple[int, ...] = (300, 301)
TIME, SLOWED = 3.0, 2.0  # s; 1/s, a drag that brings it to rest
BALL = 0.45  # m, height of the ball's middle
WAVE = 0.01  # m, of the start
PROMINENCE = 0.02  # m, of what counts as a fold
STEM = "folds"


@dataclass(frozen=True)
class FoldRow:
    """A sheet at rest on a grid of ``size`` x ``size`` vertices.

    ``ratio`` is the fabric's bending length ``(B / rho g)^(1/3)`` over the spacing. ``height`` [m] of the mean vertex
    above the lowest; ``folds`` around the border, ``fold`` [m] of border a fold; ``curvature`` [1/m], the root of the
    mean square; ``largest`` and ``p99`` strains of edges; ``speed`` [m/s] that is left; ``apart`` [mm], mean distance
    of the vertices that all grids have from where the finest grid has them (nan on the finest).
    """

    scene: str
    fabric: str
    size: int
    seed: int
    ratio: float
    height: float
    folds: int
    fold: float
    curvature: float
    largest: float
    p99: float
    speed: float
    apart: float = float("nan")


def begin(scene: Scene, seed: int) -> State:
    """The same gently waved sheet on every grid, over the ball or on the cone of Hanging."""
    rng, grid = np.random.default_rng(seed), scene.grid
    if scene.name == "Hanging":
        start = load_task("Hanging")(scene).start(rng)
        return State.still(start.positions[None], start.colliders[None])
    v, u = np.meshgrid(*(np.linspace(-0.5, 0.5, n) for n in grid.shape), indexing="ij")
    x = np.stack([u * grid.width, -v * grid.height, np.full(grid.shape, BALL + scene.colliders[0].radius + 0.02)])
    for _ in range(6):
        k, phase = rng.uniform(-4, 4, 2), rng.uniform(0, 2 * np.pi)
        x[2] += WAVE / 6 * np.sin(2 * np.pi * (k[0] * u + k[1] * v) + phase)
    return State.still(x[None], np.array([[[[0, 0, BALL]] * 2, [[0, 0, 0], [0, 0, 1.0]]]]))


def rest(scene: Scene, seed: int, time: float) -> State:
    """Where the sheet is after ``time`` [s]."""
    solver, state = ExplicitSolver(scene), begin(scene, seed)
    solver.reset(state)
    controls = Controls.hold(state, scene.handles)
    for _ in range(round(time / scene.frame_dt)):
        solver.advance(controls)
    return solver.state


def folds(grid: Grid, x: np.ndarray) -> int:
    """How many folds the border ``x`` ``(3, H, W)`` has around the vertical through its middle."""
    border = x.reshape(3, -1)[:, grid.border]
    away = np.hypot(*(border[:2] - border[:2].mean(1, keepdims=True)))
    return len(find_peaks(np.tile(away, 3), prominence=PROMINENCE)[0]) // 3


def measured(fabric: str, seed: int, state: State, scene: Scene) -> FoldRow:
    """What is told of a sheet at rest."""
    grid, material, x = scene.grid, scene.material, state.positions[0].astype(float)
    count, found = folds(grid, x), strains(grid, state.positions)
    mean_square = 2 * bend_energy(grid, [material], state.positions)[0] / (material.bend_stiffness * grid.areas.sum())
    speed = float(np.sqrt((state.velocities.astype(float) ** 2).sum(1).mean()))
    perimeter = 2 * (grid.height + grid.width)
    return FoldRow(
        scene.name, fabric, grid.rows, seed, bending_length(material) / grid.row_spacing,
        float(x[2].mean() - x[2].min()), count, perimeter / max(count, 1),
        float(np.sqrt(mean_square)), float(found.max()),
        float(np.quantile(found, 0.99)), speed,
    )  # fmt: skip


def runs(name: str, fabric: str, sizes: Sequence[int], seed: int, time: float) -> Iterator[FoldRow]:
    """One start on every grid, the finest first."""
    common, finest = min(sizes) - 1, None
    for size in sorted(sizes, reverse=True):
        material = FABRICS[fabric].with_changes(drag=SLOWED)
        scene = load_task(name).make_scene(resolution=(size, size), material=material)
        scene = replace(scene, pressure=False, self_contact=None)
        state = rest(scene, seed, time)
        every = state.positions[0, :, :: (size - 1) // common, :: (size - 1) // common].astype(float)
        finest = every if finest is None else finest
        row = measured(fabric, seed, state, scene)
        apart = np.linalg.norm(every - finest, axis=0).mean() * 1e3 if size < max(sizes) else float("nan")
        yield rounded(replace(row, apart=float(apart)))


def table(rows: Sequence[FoldRow]) -> str:
    """A line a grid: means over the starts."""
    head = (
        f"{'':10s}{'fabric':10s}{'grid':>6s}{'length/spacing':>16s}{'height [m]':>12s}{'folds':>14s}{'fold [m]':>10s}"
    )
    lines = [head + f"{'curvature [1/m]':>17s}{'strain, p99 [%]':>17s}{'apart [mm]':>12s}"]
    for scene, fabric, size in dict.fromkeys((r.scene, r.fabric, r.size) for r in rows):
        found = [r for r in rows if (r.scene, r.fabric, r.size) == (scene, fabric, size)]

        def mean(name: str, found: Sequence[FoldRow] = found) -> float:
            return float(np.mean([getattr(r, name) for r in found]))

        counts = [r.folds for r in found]
        lines.append(
            f"{scene:10s}{fabric:10s}{size:6d}{mean('ratio'):16.2f}{mean('height'):12.3f}"
            f"{f'{np.mean(counts):.1f} ({min(counts)}-{max(counts)})':>14s}{mean('fold'):10.3f}"
            f"{mean('curvature'):17.1f}"
            f"{100 * mean('largest'):9.1f}, {100 * mean('p99'):.1f}{mean('apart'):14.1f}"
        )
    return "\n".join(lines)


def measure(session: Session) -> None:
    """Every fabric from every start; rows that are there are kept."""
    sizes, time, seeds, fabrics = SIZES, TIME, SEEDS, USED
    if session.quick:
        sizes, time, seeds, fabrics = (17, 33), 1.0, SEEDS[:1], ("default",)
    session.about |= {"seeds": seeds, "time": time, "drag": SLOWED, "sizes": sizes}
    store = session.store(STEM)
    have = {(r.scene, r.fabric, r.seed) for r in store.rows if r.size == min(sizes)}
    jobs = [(s, f, seed) for s in session.scenes for f in fabrics for seed in seeds if (s, f, seed) not in have]
    for scene, fabric, seed in progress(jobs, "folds", unit="start", name=str):
        store.add(*runs(scene, fabric, sizes if seed == seeds[0] else sizes[:-1], seed, time))


BENCHMARK = Benchmark(
    name="folds",
    about="Shape, folds and strains of sheets at rest on grids of rising resolution.",
    files={STEM: RowFile(FoldRow, ("scene", "fabric", "size", "seed"))},
    parts=[Part("Sheets at rest, means over starts (least and most folds)", (STEM,), table)],
    measure=measure,
    scenes=("BallDrop", "Hanging"),
    known=("BallDrop", "Hanging"),
)
