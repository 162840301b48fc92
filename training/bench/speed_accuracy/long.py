"""Long runs: whole episodes, compared with the truth by statistics, and the gate that slow motion does not pass."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cloth_envs.physics.laws.budget import slow_motion
from cloth_envs.physics.laws.diagnostics import strains
from cloth_envs.physics.laws.sheet import bend_energy, kinetic_energy
from cloth_envs.scene import Scene
from cloth_envs.state import State
from training.bench.measure import Windows, failed_by, follow
from training.bench.participants import Participant
from training.rows import rounded

BURN_IN = 25  # frames that statistics leave out
WINDOW = 0.5  # s in which the mean height is compared


@dataclass(frozen=True)
class LongRow:
    """A run of an episode's ``frames``: distances of distributions over time from the truth's, and the height gate.

    ``height``: of the mean height, over its standard deviation. ``bending``, ``kinetic``: of these energies, over
    their mean. ``strain``: of all structural edges' strains, over their mean size. ``score``: the mean of the four, in
    %. ``gate``: largest difference of the mean height in the first half second over the way that it goes; at
    most 0.05 passes, a run that failed by then has infinity.
    """

    scene: str
    rows: int
    cols: int
    family: str
    options: str
    seed: int
    frames: int
    truth: str
    height: float
    bending: float
    kinetic: float
    strain: float
    score: float
    gate: float
    failure: str


def statistics(scene: Scene, states: Sequence[State]) -> dict[str, np.ndarray]:
    """Mean height, bending and kinetic energy ``(B, T)`` and strains ``(B, N)`` of a run."""
    grid, sheets = scene.grid, [scene.material] * states[0].batch
    share = grid.areas / grid.areas.sum()
    return {
        "height": np.stack([(s.positions[:, 2] * share).sum((1, 2)) for s in states], 1),
        "bending": np.stack([bend_energy(grid, sheets, s.positions) for s in states], 1),
        "kinetic": np.stack([kinetic_energy(grid, sheets, s.velocities) for s in states], 1),
        "strain": np.concatenate([strains(grid, s.positions) for s in states[::5]], 1),
    }


def gate_frames(scene: Scene) -> int:
    """Frames that the height gate looks at."""
    return round(np.ceil(WINDOW / scene.frame_dt - 1e-9))


def long_runs(participant: Participant, windows: Windows, threads: int = 1, burn_in: int = BURN_IN) -> list[LongRow]:
    """Run whole episodes; one row for each seed. Episodes no longer than ``burn_in`` have a gate and no statistics."""
    scene, truth, early = windows.scene, windows.truth, gate_frames(windows.scene)
    found, true, scales = follow(participant, windows, threads), {}, {}
    if len(truth) > burn_in + 1:
        true = statistics(scene, truth[burn_in:])
        scales = {"height": true["height"].std(), "strain": abs(true["strain"]).mean()}
        scales |= {name: true[name].mean() for name in ("bending", "kinetic")}
    out = []
    for i, (seed, reason) in enumerate(zip(windows.seeds, found.failures, strict=True)):
        parts: dict[str, Any] = dict.fromkeys(("height", "bending", "kinetic", "strain"), float("nan"))
        if true and not reason:
            for name, values in statistics(scene, [s.select([i]) for s in found.states[burn_in:]]).items():
                gaps = np.abs(np.sort(values[0]) - np.sort(true[name][i]))
                parts[name] = float(gaps.mean() / scales[name])
        gate = float("inf")
        if not failed_by(reason, early):
            run, fell = ([s.select([i]) for s in part[: early + 1]] for part in (found.states, truth))
            gate = float(slow_motion(scene, run, fell).fraction[0])
        row = LongRow(
            scene.name, *scene.grid.shape, participant.family, participant.text, seed, len(truth) - 1, windows.key,
            **parts, score=100 * float(np.mean(list(parts.values()))), gate=gate, failure=reason,
        )  # fmt: skip
        out.append(rounded(row))
    return out
