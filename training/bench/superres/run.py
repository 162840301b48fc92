"""``minicloth bench super-resolution``: super-resolved cloth beside the fine simulation, both free (Chen et al. 2020).

The sequences for testing of ``preset="chen2020"``, with actions of zero. A coarse cloth goes its own way in time,
so errors grow by the frame whatever the detail; how wrinkled a cloth is and whether it crosses itself compares at any
time. Errors of detail alone, on coarse cloths that the fine one follows, are told by ``minicloth train mfsr``
and the cards of the weights.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import numpy as np

from cloth_envs.backend import Backend
from cloth_envs.physics.laws.sheet import bend_energy
from cloth_envs.progress import progress
from cloth_envs.registry import PRESETS, make_backend
from cloth_envs.world import World
from training.bench.benchmark import Benchmark, Part, RowFile, Session
from training.bench.participants import Participant, extra
from training.bench.superres.chart import PICTURES, draw, pictures
from training.metrics.contact import crossing_triangles, inside
from training.metrics.detail import fine_detail
from training.metrics.errors import vertex_error
from training.rollouts import record, replay
from training.rows import rounded
from training.superres.convergence import CONVERGENCE, ConvergenceRow

STEM, PRESET, FACTOR = "superres", "chen2020", 4
FRAMES, QUICK, EVERY = 400, 20, 5  # frames of a sequence; of --quick; from one that is looked at to the next
SHOWN = (5, 20)  # frames after which errors are told
METHODS = (
    Participant("reference", "reference", {}, name="fine"),
    Participant("bicubic", "miniature", {"factor": FACTOR, "scaling": "similar", "upscaler": "bicubic", "mend": False}),
    Participant("mfsr", "mfsr", {}),
)


@dataclass(frozen=True)
class SuperresRow:
    """One sequence by one backend.

    Attributes:
        ms, step_ms: wall clock of a frame's thread, the part until the coarse cloth is there; ratio: of the fine
            simulation's to it. error_5, error_20: mean vertex distance from the fine simulation [mm].
        bending, detail: bending energy, and what is finer than the coarse grid's Nyquist wave, over those of the fine
            simulation, both means over frames; of a tube the latter is NaN. crossings, inside: the most pairs of
            triangles and vertices in bodies of any frame that was looked at.
    """

    scene: str
    sequence: int
    family: str
    options: str
    frames: int
    ms: float
    step_ms: float
    ratio: float
    error_5: float
    error_20: float
    bending: float
    detail: float
    crossings: int
    inside: int
    plain: str


def free_runs(scene: str, sequence: int, methods: Sequence[Participant], frames: int) -> list[SuperresRow]:
    """Rows of ``methods``, the fine simulation first."""
    world = World(scene, preset={"name": PRESET, "sequence": sequence})
    run = record(world, np.zeros((frames, 1, len(world.task.actions))), [0], seeds=[sequence])
    truth: list[np.ndarray] = []
    rows, own, grid = [], {"ms": 0.0, "bending": 0.0, "detail": 0.0}, world.scene.grid
    for method in methods:
        backend: Backend = make_backend(method.backend, run.scene, backend_kwargs=method.whole)
        times, told, path = [], [], []
        for frame, (state, seconds) in enumerate(replay(backend, run.states[0], run.controls), 1):
            times.append((seconds.thread, seconds.step * seconds.thread / seconds.wall))
            if frame % EVERY and frame not in SHOWN:
                continue
            x = state.positions.copy()
            path.append((frame, x))
            bend = float(bend_energy(grid, run.materials, x)[0])
            fine = float("nan") if grid.periodic else float(fine_detail(grid, x, FACTOR)[0])
            told.append((bend, fine, int(crossing_triangles(grid, x)[0]), int(inside(run.scene, state).count[0])))
        truth = truth or [x for _, x in path]
        away = {k: float(vertex_error(x, y, 1e-3).mean[0]) / 100 for (k, x), y in zip(path, truth, strict=True)}
        bending, detail, crossings, within = np.array(told).T
        ms, step = (1e3 * median(part) for part in zip(*times, strict=True))
        means = {"ms": ms, "bending": bending.mean(), "detail": detail.mean()}
        own = means if method is methods[0] else own
        row = SuperresRow(
            scene, sequence, method.family, method.text, frames, ms, step, own["ms"] / ms,
            away.get(SHOWN[0], np.nan), away.get(SHOWN[1], np.nan), means["bending"] / own["bending"],
            means["detail"] / own["detail"], int(crossings.max()), int(within.max()),
            str(getattr(backend, "surrogate", [""])[0]),
        )  # fmt: skip
        rows.append(rounded(row))
    return rows


def table(rows: Sequence[SuperresRow]) -> str:
    """A line for every sequence and backend."""
    names = ("ms", "step_ms", "ratio", "error_5", "error_20", "bending", "detail", "crossings", "inside")
    lines = [f"{'':40s}" + "".join(f"{name:>10s}" for name in names)]
    for row in rows:
        numbers = "".join(f"{getattr(row, name):10.4g}" for name in names)
        lines.append(f"{row.scene:9s}{row.sequence:3d} {row.family:27s}{numbers}  {row.plain}".rstrip())
    return "\n".join(lines)


def measure(session: Session) -> None:
    """What is missing of every scene's sequences for testing."""
    from training.superres.generate import Protocol

    if session.given.pictures:
        return pictures(session.images or Path())
    store, methods = session.store(STEM), [*METHODS, *extra(session.given.backend)]
    frames = QUICK if session.quick else FRAMES
    session.about |= {"preset": PRESET, "frames": frames, "every": EVERY}
    for scene in session.scenes:
        usual = Protocol.of(scene)
        for sequence in progress(range(usual.trained, usual.sequences), f"{STEM} {scene}"):
            if not all((scene, sequence, m.family, m.text) in store for m in methods):
                store.add(*free_runs(scene, sequence, methods, min(frames, usual.frames)))


BENCHMARK = Benchmark(
    name="super-resolution",
    about="What super-resolved cloth costs beside the fine simulation, and whether it is as wrinkled.",
    files={
        STEM: RowFile(SuperresRow, ("scene", "sequence", "family", "options")),
        CONVERGENCE: RowFile(ConvergenceRow),
    },
    parts=[Part("Time of a frame, error, wrinkles over the fine simulation's, and contact", (STEM,), table)],
    measure=measure,
    scenes=tuple(PRESETS[PRESET]),
    known=tuple(PRESETS[PRESET]),
    charts={
        CONVERGENCE: "How published networks converge (figure 13), of rows of `minicloth train mfsr-published`",
        PICTURES: "Coarse, interpolated, super-resolved and tracked cloths (figures 9-12)",
    },
    draw=draw,
    options=lambda top: top.add_argument("--pictures", action="store_true", help="only the pictures, into --images"),
)
