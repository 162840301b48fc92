"""``minicloth bench wrinkles``: whether the cloth that a miniature draws is one.

The reference and miniatures play equal seeds by equal actions of every kind, long enough for an agent's episode: how
many end where the reference does not, and strains, bending energy and acceleration beside the reference's. Miniatures
start again at some of its states too, for their errors after some frames; and their time is taken in turn.
"""

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from statistics import fmean

import numpy as np
from gymnasium.utils.seeding import np_random

from cloth_envs.physics.laws.diagnostics import strain
from cloth_envs.physics.laws.sheet import bend_energy
from cloth_envs.progress import progress
from cloth_envs.state import Controls, State
from cloth_envs.world import World
from training.bench.benchmark import Benchmark, Part, RowFile, Session
from training.bench.clock import CostRow, costs
from training.bench.measure import Windows, mean
from training.bench.participants import WRINKLES, Participant, extra
from training.metrics.errors import vertex_error
from training.rollouts import replay, seeded_actions
from training.rows import rounded

STEM, COST = "wrinkles", "wrinkles_cost"
ACTIONS = ("bang-bang", "random", "alternating", "smooth")
SEEDS, FRAMES, EVERY = range(700, 712), 200, 5  # EVERY: frames from one that is looked at to the next
STARTS, AHEAD = (20, 60, 100, 140, 180), (5, 10)  # frames: of the reference's that errors start at, and how long


@dataclass(frozen=True)
class WrinkleRow:
    """Episodes of one scene and backend under actions of one kind.

    Attributes:
        ended, lost: episodes that failed, and those of them that the reference survived. guarded: cloths of 1000 that
            the guard drew. The rest is of members that lived on both.
        strain, strain_truth: mean over frames of the 99th percentile of the structural edges' ``|strain|``.
        bending, acceleration: energy and root-mean-square, over the reference's.
        error_5, error_10: mean vertex error after so many frames from the reference's states [% of the length].
    """

    scene: str
    backend: str
    options: str
    actions: str
    episodes: int
    ended: int
    lost: int
    guarded: float
    strain: float
    strain_truth: float
    bending: float
    acceleration: float
    error_5: float
    error_10: float


@dataclass
class Trace:
    """What is seen of a batch: of every frame that is looked at ``(B,)`` in a list, of its end, and what is kept."""

    strain: list[np.ndarray] = field(default_factory=list)
    bending: list[np.ndarray] = field(default_factory=list)
    square: list[np.ndarray] = field(default_factory=list)  # of the acceleration [m^2/s^4]
    ended: np.ndarray = field(default_factory=lambda: np.zeros(0, bool))
    guarded: int = 0
    states: dict[int, State] = field(default_factory=dict)
    controls: list[Controls] = field(default_factory=list)


def watch(world: World, actions: np.ndarray, seeds: Sequence[int], keep: Iterable[int] = ()) -> Trace:
    """Play ``actions`` ``(T, B, A)``, keeping the states at the ends of frames ``keep`` and all controls."""
    trace, wanted, grid = Trace(ended=np.zeros(len(seeds), bool)), set(keep), world.scene.grid
    last: list[np.ndarray] = []
    world.reset({i: np_random(seed)[0] for i, seed in enumerate(seeds)})
    for frame, action in enumerate(actions, 1):
        reasons = world.step(action)[1]
        trace.ended |= [reason is not None for reason in reasons]
        x = world.state.positions.astype(np.float64)
        trace.guarded += int(world.guarded.sum())
        assert world.controls is not None
        trace.controls.append(Controls(**{name: np.array(value) for name, value in vars(world.controls).items()}))
        last = [*last[-2:], x]
        if frame in wanted:
            trace.states[frame] = world.state.copy()
        if frame % EVERY == 0:
            turn = (last[2] - 2 * last[1] + last[0]) / world.scene.frame_dt**2
            trace.strain.append(strain(grid, x).p99)
            trace.bending.append(bend_energy(grid, world.materials, x))
            trace.square.append((turn**2).sum(1).mean((1, 2)))
    return trace


def errors(one: Participant, world: World, truth: Trace) -> list[float]:
    """``error_5`` and ``error_10`` of restarts from the states of ``truth``."""
    found: list[list[float]] = [[] for _ in AHEAD]
    backend = one.build(world.scene, world.num_envs)
    for start in (frame for frame in STARTS if frame in truth.states):
        run = replay(backend, truth.states[start], truth.controls[start : start + max(AHEAD)])
        for frame, (state, _) in enumerate(run, 1):
            if frame in AHEAD:
                error = vertex_error(state.positions, truth.states[start + frame].positions, world.scene.grid.length)
                found[AHEAD.index(frame)] += error.mean[~truth.ended].tolist()
    return [fmean(values) if values else float("nan") for values in found]


def compare(one: Participant, scene: str, actions: str, moves: np.ndarray, truth: Trace, world: World) -> WrinkleRow:
    """The row of a participant; ``world`` is the reference's."""
    seeds = SEEDS[: world.num_envs]
    trace = watch(World(scene, num_envs=len(seeds), backend=one.backend, backend_kwargs=one.whole), moves, seeds)
    good = ~(trace.ended | truth.ended)

    def both(name: str) -> list[float]:
        seen = [np.array(getattr(each, name))[:, good] for each in (trace, truth)]
        return [float(values.mean()) if values.size else float("nan") for values in seen]

    (strained, strained_truth), (bent, bent_truth), (square, square_truth) = map(both, ("strain", "bending", "square"))
    after_5, after_10 = errors(one, world, truth)
    row = WrinkleRow(
        scene, one.label, json.dumps(one.whole), actions, len(seeds),
        int(trace.ended.sum()), int((trace.ended & ~truth.ended).sum()), 1000 * trace.guarded / moves[..., 0].size,
        strained, strained_truth, bent / bent_truth, float(np.sqrt(square / square_truth)), after_5, after_10,
    )  # fmt: skip
    return rounded(row)


def times(session: Session) -> None:
    """Every backend's time that is missing, from where the first kind of action has brought the reference."""
    participants, timed = [*WRINKLES, *extra(session.given.backend)], session.store(COST)
    seeds, until = SEEDS[: 2 if session.quick else len(SEEDS)], STARTS[0] + max(AHEAD)
    for scene in progress(session.scenes, "times", unit="scene", name=str):
        if all((scene, p.family, p.text) in timed for p in participants):
            continue
        world = World(scene, num_envs=len(seeds))
        truth = watch(world, seeded_actions(world, seeds, ACTIONS[:1], until), seeds, STARTS[:1])
        first = truth.controls[STARTS[0] :]
        windows = Windows(world.scene, tuple(seeds), STARTS[:1], first, [truth.states[STARTS[0]]], "")
        timed.add(*costs(participants, windows, runs=3 if session.quick else 21))


def measure(session: Session) -> None:
    """Every scene, backend and kind of action that is missing."""
    participants, store = [*WRINKLES, *extra(session.given.backend)], session.store(STEM)
    seeds, frames = (SEEDS[:2], 40) if session.quick else (SEEDS, FRAMES)
    session.about |= {"seeds": list(seeds), "frames": frames, "starts": STARTS}
    for scene, actions in progress([(scene, kind) for scene in session.scenes for kind in ACTIONS], STEM, name=str):
        key = [(scene, one.label, json.dumps(one.whole), actions) for one in participants]
        missing = [one for one, this in zip(participants, key, strict=True) if this not in store]
        if not missing:
            continue
        world = World(scene, num_envs=len(seeds))
        moves = seeded_actions(world, seeds, [actions], frames)
        keep = [start + ahead for start in STARTS for ahead in (0, *AHEAD) if start + max(AHEAD) <= frames]
        truth = watch(world, moves, seeds, keep)
        store.add(*(compare(one, scene, actions, moves, truth, world) for one in missing))


def table(rows: Sequence[WrinkleRow]) -> str:
    """A line a scene and backend: sums and means over kinds of action."""
    lines = [
        f"{'':36s}{'ended':>7s}{'lost':>6s}{'guarded':>9s}{'strain':>8s}{'truth':>7s}{'bending':>9s}{'accel.':>8s}"
        f"{'error, 5':>10s}{'10 frames':>11s}"
    ]
    for scene, backend in dict.fromkeys((r.scene, r.backend) for r in rows):
        mine = [r for r in rows if (r.scene, r.backend) == (scene, backend)]

        def over(name: str, mine: Sequence[WrinkleRow] = mine) -> float:
            return mean([getattr(r, name) for r in mine])

        lines.append(
            f"{scene:12s}{backend:24s}{sum(r.ended for r in mine):7d}{sum(r.lost for r in mine):6d}"
            f"{over('guarded'):9.2f}{over('strain'):8.3f}{over('strain_truth'):7.3f}{over('bending'):9.2f}"
            f"{over('acceleration'):8.2f}{over('error_5'):10.3f}{over('error_10'):11.3f}"
        )
    return "\n".join(lines)


def cost_table(rows: Sequence[CostRow]) -> str:
    """A line a scene and backend: its frame, and of that the upscaling."""
    lines = [f"{'':36s}{'ms a frame':>12s}{'upscaling':>11s}"]
    lines += [f"{r.scene:12s}{r.family:24s}{r.ms_median:12.4f}{r.upscale_ms:11.4f}" for r in rows]
    return "\n".join(lines)


BENCHMARK = Benchmark(
    name=STEM,
    about="Strains, wrinkles and ends of the cloth that miniatures draw, beside the reference's, under all actions.",
    files={
        STEM: RowFile(WrinkleRow, ("scene", "backend", "options", "actions")),
        COST: RowFile(CostRow, ("scene", "family", "options")),
    },
    parts=[
        Part("The drawn cloth beside the reference's, over all actions", (STEM,), table),
        Part("Its time", (COST,), cost_table),
    ],
    measure=measure,
    times=times,
)
