"""``minicloth bench synchronised``: how closely fine cloths follow coarse ones, and what no predictor can know of them.

Test sequences of Chen et al. 2020. The fine cloth moves freely, then pulled along by each kind of tracking, under the
same controls. A twin of the usual tracking starts with 1 mm of noise along its normals: where both end up is chance, so
no function of the coarse cloth can be closer to either than the distance over the square root of two (the floor).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from cloth_envs.grid import Grid
from cloth_envs.physics.explicit.solver import ExplicitSolver
from cloth_envs.physics.laws.sheet import bend_energy
from cloth_envs.progress import progress
from cloth_envs.registry import PRESETS
from cloth_envs.resample import resample
from cloth_envs.scene import Scene
from cloth_envs.state import State
from cloth_envs.world import World
from surrogates.superres.synchronised import Synchronised
from training.bench.benchmark import Benchmark, Part, RowFile, Session
from training.bench.synchronised.chart import CHARTS, draw
from training.bench.synchronised.rows import FLOOR, FREE, TRACKED, FloorRow, TrackingRow, floor_table, tracking_table
from training.metrics.detail import normal_angle, normals
from training.rollouts import Recording, record, replay
from training.rows import rounded
from training.superres.generate import PRESET, Plan, Protocol

FACTOR, FRAMES, SETTLED = 4, 160, 20  # frames of a run, and those of them that do not count
SEQUENCES = 3  # of those for testing, at most
NOISE = 1e-3  # m
TRACKINGS: Mapping[str, dict[str, Any]] = {"mean": {}, "seed": {}, "springs": {"tracking": "seed", "levels": 0.0}}


def bumps(grid: Grid, positions: np.ndarray) -> np.ndarray:
    """How far vertices lie from the mean of their neighbours, ``(..., H, W)`` [m], 0 at open borders."""
    x = positions.astype(np.float64)
    beside = np.roll(x, 1, -1) + np.roll(x, -1, -1)
    away = np.linalg.norm(x[..., 1:-1, :] - (x[..., :-2, :] + x[..., 2:, :] + beside[..., 1:-1, :]) / 4, axis=-3)
    out = np.zeros((*x.shape[:-3], *grid.shape))
    out[..., 1:-1, :] = away
    if not grid.periodic:
        out[..., [0, -1]] = 0.0
    return out


def spikes(grid: Grid, positions: np.ndarray, factor: int = FACTOR) -> tuple[float, float]:
    """Root mean square of ``bumps`` inside the sheet: at shared vertices over that at others, and of others [m]."""
    inside, shared = np.zeros(grid.shape, bool), np.zeros(grid.shape, bool)
    inside[1:-1, slice(None) if grid.periodic else slice(1, -1)] = True
    shared[::factor, ::factor] = True
    square = bumps(grid, positions) ** 2
    at, others = (np.sqrt(square[..., inside & which].mean()) for which in (shared, ~shared))
    return float(at / others), float(others)


def noisy(scene: Scene, state: State, seed: int) -> State:
    """``state``, its free vertices ``NOISE`` along their normals from where they were."""
    out, rng = state.copy(), np.random.default_rng(seed)
    push = NOISE * rng.standard_normal((state.batch, 1, *scene.grid.shape)) * normals(scene.grid, state.positions)
    push.reshape(*push.shape[:2], -1)[..., list(scene.handles)] = 0.0
    out.positions += push
    return out


@dataclass(frozen=True)
class Runs:
    """Frames after ``SETTLED`` of a fine cloth and the coarse one, ``(T, 3, H, W)`` [m], and what they took."""

    fine: np.ndarray
    coarse: np.ndarray
    ms: float
    crossings: int


def run(solver: ExplicitSolver, free: Recording) -> Runs:
    """Go on from where ``solver`` is, under the controls of ``free``."""
    fine, coarse, times, most = [], [], [], 0
    for frame, (state, seconds) in enumerate(replay(solver, None, free.controls), 1):
        times.append(1e3 * seconds.cpu)
        most = max(most, int(solver.crossings[0]))
        if frame > SETTLED:
            fine.append(state.positions[0])
            coarse.append(solver.coarse.positions[0] if isinstance(solver, Synchronised) else fine[-1])
    return Runs(np.stack(fine), np.stack(coarse), float(np.mean(times)), most)


def tracking_row(scene: Scene, name: str, sequence: int, found: Runs) -> TrackingRow:
    """What is told of a run."""
    grid = scene.grid
    apart = found.fine[..., ::FACTOR, ::FACTOR] - found.coarse if name != FREE else np.full((1, 3), np.nan)
    ratio, rough = spikes(grid, found.fine)
    bending = bend_energy(grid, [scene.material] * len(found.fine), found.fine).mean()
    return rounded(
        TrackingRow(
            scene.name, name, sequence, *grid.shape, SETTLED + len(found.fine),
            float(1e3 * np.linalg.norm(apart, axis=1).mean()), ratio, 1e3 * rough, float(bending), found.ms,
            found.crossings,
        )
    )  # fmt: skip


def floor_row(scene: Scene, coarse: Grid, sequence: int, one: Runs, twin: Runs) -> FloorRow:
    """What twins tell of the floor."""
    grid = scene.grid
    rms = [
        float(1e3 * np.sqrt(np.square(a - b).sum(1).mean()))
        for a, b in ((one.fine, twin.fine), (one.fine, resample(one.coarse.astype(np.float64), coarse, grid)))
    ]
    angle = float(normal_angle(grid, one.fine, twin.fine).mean())
    frames = SETTLED + len(one.fine)
    return rounded(FloorRow(scene.name, sequence, *grid.shape, frames, rms[0] / np.sqrt(2), rms[1], angle / np.sqrt(2)))


def sequence_rows(scene: str, sequence: int, frames: int) -> Iterator[TrackingRow | FloorRow]:
    """All rows of a sequence."""
    world = World(scene, preset={"name": PRESET, "sequence": sequence})
    own = world.scene
    actions = np.zeros((frames, 1, len(world.task.actions)))
    free = record(world, actions, [0], seeds=[sequence])
    solver = ExplicitSolver(own)
    solver.reset(free.states[0])
    yield tracking_row(own, FREE, sequence, run(solver, free))
    for name, options in TRACKINGS.items():
        plan = Plan.usual(scene, frames, factor=FACTOR, tracking=options.get("tracking", name))
        cloths = Synchronised(own, **plan.options | options)
        cloths.reset(free.states[0])
        found = run(cloths, free)
        yield tracking_row(own, name, sequence, found)
        if name == "mean":
            cloths.reset(free.states[0])
            cloths.disturb(noisy(own, free.states[0], sequence))
            yield floor_row(own, cloths.coarse_scene.grid, sequence, found, run(cloths, free))


def measure(session: Session) -> None:
    """Every sequence; rows that are there are kept."""
    frames, most = (SETTLED + 5, 1) if session.quick else (FRAMES, SEQUENCES)
    session.about |= {"frames": frames, "settled": SETTLED, "noise": NOISE, "factor": FACTOR}
    tracked, floors = session.store(TRACKED), session.store(FLOOR)
    jobs = []
    for scene in session.scenes:
        protocol = Protocol.of(scene)
        numbers = range(max(protocol.trained, protocol.sequences - most), protocol.sequences)
        jobs += [(scene, n) for n in numbers if not all((scene, name, n) in tracked for name in (FREE, *TRACKINGS))]
    for scene, number in progress(jobs, "synchronised", unit="sequence", name=str):
        for row in sequence_rows(scene, number, frames):
            (tracked if isinstance(row, TrackingRow) else floors).add(row)


BENCHMARK = Benchmark(
    name="synchronised",
    about="How closely fine cloths follow coarse ones that they are pulled along with, and what of them is chance.",
    files={
        TRACKED: RowFile(TrackingRow, ("scene", "tracking", "sequence")),
        FLOOR: RowFile(FloorRow, ("scene", "sequence")),
    },
    parts=[
        Part("Tracking, means over test sequences (least-most)", (TRACKED,), tracking_table),
        Part("Floor: tracked twins over the square root of two", (FLOOR,), floor_table),
    ],
    measure=measure,
    scenes=tuple(PRESETS[PRESET]),
    known=tuple(PRESETS[PRESET]),
    charts=CHARTS,
    draw=draw,
)
