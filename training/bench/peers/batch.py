"""Batches: ``mujoco.rollout`` beside what ``gymnasium.make_vec`` steps, on the same three scenes.

Taichi's kernels have no batch: 32 cloths take it 32 times as long as one.
"""

import json
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from cloth_envs.state import Controls, State
from training.bench.participants import Participant
from training.bench.peers.results import OWN, PeerRow, label, rivals
from training.bench.peers.scenes import LATE, TITLES, Setup, clock

BATCH = 32
BATCH_STEM = "peers_batch"


@dataclass(frozen=True)
class BatchRow:
    """Processor time of all threads, and wall clock, for a frame of one of ``batch`` cloths that start alike [ms].

    A mean over the frames of half a second; ``name`` is for people.
    """

    scene: str
    engine: str
    settings: str
    instruction_set: str
    threads: int
    batch: int
    name: str
    cpu_ms: float
    wall_ms: float


BATCH_KEY = ("scene", "engine", "settings", "instruction_set", "threads")


def batch_table(rows: Sequence[BatchRow]) -> str:
    """A line a scene and number of threads: MuJoCo's, and ours with how many times faster it is."""
    lines = [f"{'scene':26s}{'cloths':>7s}{'threads':>8s}"]
    for scene, threads in dict.fromkeys((r.scene, r.threads) for r in rows):
        some = [r for r in rows if (r.scene, r.threads) == (scene, threads)]
        lines.append(f"{TITLES[scene]:26s}{some[0].batch:7d}{threads:8d}")
        peers = [r.cpu_ms for r in some if r.engine != OWN]
        for r in some:
            ratio = f"{peers[0] / r.cpu_ms:8.1f} x faster" if peers and r.engine == OWN else ""
            lines.append(f"  {r.name:62s}{f'{r.cpu_ms:.3g} ({r.wall_ms:.3g}) ms':>20s}{ratio}")
    return "\n".join(lines)


def copies(setup: Setup) -> tuple[State, Controls]:
    """The start and what holds, ``BATCH`` times."""
    start = setup.start
    state = State.still(np.repeat(start.positions, BATCH, 0), np.repeat(start.colliders, BATCH, 0))
    controls = Controls.hold(state, setup.scene.handles)
    if setup.scene.windy:
        controls.wind[:] = setup.controls.wind
    return state, controls


def ours(setup: Setup, chosen: Participant, threads: int) -> np.ndarray:
    """``clock`` for a frame and cloth [s]."""
    state, controls = copies(setup)
    engine = chosen.build(setup.scene, BATCH, threads)
    engine.reset(state)
    engine.advance(controls)  # warms up
    engine.reset(state)
    frames, begin = setup.frames(LATE), clock()
    for _ in range(frames):
        engine.advance(controls)
    taken: np.ndarray = clock() - begin
    return taken / (frames * BATCH)


def mujocos(setup: Setup, settings: str, threads: int) -> np.ndarray:
    """The same by ``mujoco.rollout``; the wind as the force that it has on the cloth at the start."""
    import mujoco
    from mujoco.rollout import Rollout

    from cloth_envs.physics.laws.air import air_forces
    from training.bench.peers.mujoco import MujocoCloth

    cloth = MujocoCloth(setup, **json.loads(settings))
    kind, given = mujoco.mjtState.mjSTATE_FULLPHYSICS, mujoco.mjtState.mjSTATE_QFRC_APPLIED
    start = np.empty(mujoco.mj_stateSize(cloth.model, kind))
    mujoco.mj_getState(cloth.model, cloth.data, start, kind)
    state, forces = np.tile(start, (BATCH, 1)), np.zeros((1, 1, cloth.model.nv))
    if setup.scene.air is not None:
        x, v = cloth.read()
        forces[:] = air_forces(setup.scene, x[None], v[None], setup.controls.wind)[0][:, cloth.free].T.ravel()
    frames = setup.frames(LATE)
    steps = frames * cloth.substeps
    with Rollout(nthread=threads) as pool:
        data = [mujoco.MjData(cloth.model) for _ in range(threads)]
        begin = clock()
        for _ in range(steps):  # one by one: after a warning, such as of contact, a rollout repeats its last state
            after, _ = pool.rollout(cloth.model, data, state, forces, control_spec=given)
            state = after[:, -1]
        taken: np.ndarray = clock() - begin
    return taken / (frames * BATCH)


def measure_batch(setup: Setup, rows: Sequence[PeerRow], pools: Mapping[str, Executor]) -> list[BatchRow]:
    """MuJoCo's fastest setting that passes on a single cloth, and the fastest of ours that is no further off."""
    scene, found = setup.scene.name, []
    passing = [r for r in rows if (r.scene, r.engine) == (scene, "MuJoCo") and r.passed]
    peer = min(passing, key=lambda r: r.ms, default=None)
    mine = [r for level in pools for p, r in rivals(rows, scene, level) if p is peer and r]
    for threads in sorted({1, os.cpu_count() or 1}):
        if peer:
            found.append((peer, threads, mujocos(setup, peer.settings, threads)))
        for r in mine:
            chosen = Participant(OWN, options=json.loads(r.settings))
            found.append((r, threads, pools[r.instruction_set].submit(ours, setup, chosen, threads).result()))
    return [
        BatchRow(scene, r.engine, r.settings, r.instruction_set, n, BATCH, label(r), *(1e3 * taken[::-1]).tolist())
        for r, n, taken in found
    ]
