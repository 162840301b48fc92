"""Rows of the speed-accuracy benchmark: the gate that slow motion does not pass, and one for each method and horizon;
their table and front.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cloth_envs.physics.laws.budget import slow_motion
from cloth_envs.scene import Scene
from training.bench.clock import CostRow
from training.bench.measure import MEASURED, ErrorRow, Windows, follow, mean
from training.bench.participants import FLOOR, ORACLE, Participant, label
from training.rows import rounded

WINDOW = 0.5  # s in which the mean height is compared
TIMES = ("ms_q1", "ms_median", "ms_q3", "ms_best", "upscale_ms")
GATE = 0.05  # of the way that the mean height goes
BASELINE = "miniature similar"


@dataclass(frozen=True)
class GateRow:
    """The first ``frames``, half a second, of an episode.

    ``gate``: largest difference of the mean height from the truth's over the way that it goes; at most 0.05 passes, a
    run that failed has infinity.
    """

    scene: str
    rows: int
    cols: int
    family: str
    options: str
    seed: int
    frames: int
    truth: str
    gate: float
    failure: str


def gate_frames(scene: Scene) -> int:
    """Frames that the height gate looks at."""
    return round(np.ceil(WINDOW / scene.frame_dt - 1e-9))


def gates(participant: Participant, windows: Windows) -> list[GateRow]:
    """Run the beginnings of episodes; one row for each seed."""
    scene, truth = windows.scene, windows.truth
    found, out = follow(participant, windows), []
    for i, (seed, reason) in enumerate(zip(windows.seeds, found.failures, strict=True)):
        gate = float("inf")
        if not reason:
            run, fell = ([s.select([i]) for s in states] for states in (found.states, truth))
            gate = float(slow_motion(scene, run, fell).fraction[0])
        row = GateRow(
            scene.name, *scene.grid.shape, participant.family, participant.text, seed, len(truth) - 1, windows.key,
            gate, reason,
        )  # fmt: skip
        out.append(rounded(row))
    return out


@dataclass(frozen=True)
class SpeedAccuracyRow:
    """A method after ``frames``: time of a frame [ms], errors [% of the cloth's length] as mean, least and largest of
    the seeds, and the means of the other metrics.

    ``floor`` is the chaos floor of the same windows, below which an error means nothing. ``skill`` is against coarse
    physics and bicubic upscaling (of the method's own grid factor, or 2). ``gate`` is the median over the seeds.
    """

    scene: str
    family: str
    options: str
    frames: int
    windows: int
    ms_q1: float
    ms_median: float
    ms_q3: float
    ms_best: float
    upscale_ms: float
    error: float
    error_low: float
    error_high: float
    floor: float
    skill: float
    error_p95: float
    error_max: float
    relative_l2: float
    psnr: float
    vmse: float
    max_dx: float
    normal_deg: float
    curvature: float
    bending_ratio: float
    detail_ratio: float
    flicker: float
    depth_max: float
    inside: float
    tunnelled: float
    crossings: float
    gate: float
    failure: str

    @property
    def survived(self) -> bool:
        """Whether at least half of the windows stood: the mean of fewer tells of the easiest ones."""
        lost = int(self.failure.split(" of ", 1)[0]) if self.failure else 0
        return 2 * lost <= self.windows

    @property
    def passes(self) -> bool:
        """It did not fail and its cloth falls as fast as the truth's (unknown counts as passed)."""
        return not self.failure and not self.gate > GATE


def factor_of(options: str) -> float:
    """The grid factor among a row's options, or 2."""
    return float(json.loads(options).get("factor", 2))


def summaries(scores: Sequence[ErrorRow], costs: Sequence[CostRow], gated: Sequence[GateRow]) -> list[SpeedAccuracyRow]:
    """One row for each scene, method and horizon."""
    groups: dict[tuple[str, str, str, int], list[ErrorRow]] = {}
    for s in scores:
        groups.setdefault((s.scene, s.family, s.options, s.frames), []).append(s)
    errors = {key: mean([s.error_mean for s in mine]) for key, mine in groups.items()}
    bases = {(s, factor_of(o), h): e for (s, f, o, h), e in errors.items() if f == BASELINE}
    times = {(c.scene, c.family, c.options): c for c in costs}
    out = []
    for (scene, family, options, frames), mine in groups.items():
        time = times.get((scene, family, options))
        error = errors[scene, family, options, frames]
        own = [s.error_mean for s in mine if not np.isnan(s.error_mean)] or [float("nan")]
        means = {n: mean([getattr(s, n) for s in mine]) for n in MEASURED if n in SpeedAccuracyRow.__dataclass_fields__}
        failed = [s.failure.split(" of ", 1) for s in mine if s.failure]
        bad, windows = sum(int(count) for count, _ in failed), sum(s.windows for s in mine)
        falls = [r.gate for r in gated if (r.scene, r.family, r.options) == (scene, family, options)]
        row = SpeedAccuracyRow(
            scene=scene,
            family=family,
            options=options,
            frames=frames,
            windows=windows,
            **{n: getattr(time, n) if time else np.nan for n in TIMES},
            error=error,
            error_low=min(own),
            error_high=max(own),
            floor=errors.get((scene, FLOOR, "{}", frames), np.nan),
            skill=1 - error / bases.get((scene, factor_of(options), frames), np.nan),
            **means,
            gate=float(np.median(falls)) if falls else np.nan,
            failure=f"{bad} of {windows}: {failed[0][1].split(': ', 1)[1]}" if bad else "",
        )
        out.append(rounded(row))
    return out


def front(rows: Sequence[SpeedAccuracyRow]) -> list[SpeedAccuracyRow]:
    """The rows that nothing passing is both faster and closer than; errors below the chaos floor count as that."""
    best, out = np.inf, []
    for row in sorted(rows, key=lambda r: (r.ms_median, r.error)):
        found = max(row.error, row.floor if row.floor > 0 else 0)
        if row.passes and row.family not in (ORACLE, FLOOR) and np.isfinite(row.ms_median) and found < best:
            best = found
            out.append(row)
    return out


def table(rows: Sequence[SpeedAccuracyRow]) -> str:
    """Errors after every horizon, one line a method, and pairs of triangles that cross after the last one.

    An error in brackets is below the chaos floor.
    """
    lines = []
    horizons = sorted({r.frames for r in rows})
    for scene in dict.fromkeys(r.scene for r in rows):
        mine = {(r.family, r.options, r.frames): r for r in rows if r.scene == scene}
        heads = "".join(f"{f'{h} fr.':>10s}" for h in horizons)
        lines.append(f"{scene:46s}{'ms (quartiles)':>22s}{heads}{'gate':>7s}{'pairs':>8s}")
        for family, options in dict.fromkeys((f, o) for f, o, _ in mine):
            found = [mine[family, options, h] for h in horizons if (family, options, h) in mine]
            r = found[-1]
            time = f"{r.ms_median:.3g} ({r.ms_q1:.3g}-{r.ms_q3:.3g})" if np.isfinite(r.ms_median) else ""
            texts = [f"({x.error:.2g})" if x.error < x.floor else f"{x.error:.3g}" for x in found]
            gate = "" if np.isnan(r.gate) else f"{100 * r.gate:.0f}%"
            lines.append(
                f"{label(family, options):46s}{time:>22s}{''.join(f'{t:>10s}' for t in texts)}{gate:>7s}"
                + f"{r.crossings:8.3g}"
                + (f"  {r.failure[:60]}" if r.failure else "")
            )
    return "\n".join(lines)
