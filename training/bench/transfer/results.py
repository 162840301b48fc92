"""What the transfer benchmark has measured: trainings, episodes, both put together with intervals; table and chart."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
from scipy.stats import t as student

from cloth_envs.style import COLORS, INK, limits, spread
from training.bench.charts import SOFT, dress, grid, legend, save

STEM = "transfer"
REFERENCE, ZERO, RANDOM = "reference", "zero action", "random action"
CMA_ES, PPO = "CMA-ES", "PPO"
# Okabe & Ito (2008), as the other charts have them.
KNOWN = {REFERENCE: "#0072B2", "similar": "#E69F00", "miniature": "#000000"}
MARKERS = {"": "o", "2": "s", "4": "^", "4 longer": "*"}
FLOORS = {ZERO: (0, (4, 2)), RANDOM: (0, (1, 2))}
APART = 0.03  # of the axis: where times are nearly equal, points are moved this far apart
TICKS = (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500)  # s
NOTE = (
    "In a panel all have the same policy, seeds and episodes (longer: 4 times as many). Filled: reward on the "
    "reference, bars 95 % over seeds and trainings. Hollow: on the backend that it was trained on. Upper left is "
    "better. Points of nearly equal time are moved apart."
)


@dataclass(frozen=True)
class TrainingRow:
    """One training: on what (``policy``), how many episodes of how many frames, its time, what it found (the network of
    PPO is not kept), and by which ``learner``.
    """

    scene: str
    rows: int
    cols: int
    policy: str
    repetition: int
    episodes: int
    frames: int
    wall_s: float
    processor_s: float
    weights: str
    learner: str = CMA_ES


@dataclass(frozen=True)
class EpisodeRow:
    """Mean reward per frame of a policy on one held-out seed, on the backend ``scored_on``; ``failed`` is 0 or 1."""

    scene: str
    rows: int
    cols: int
    policy: str
    repetition: int
    scored_on: str
    seed: int
    reward: float
    failed: int
    learner: str = CMA_ES


@dataclass(frozen=True)
class TransferRow:
    """A policy's rewards per frame on the reference and on its own backend, with half widths of 95 % intervals over
    seeds and trainings. Time is the median of the trainings.

    ``gap`` is the reward on the reference less that of the policy which the same ``learner`` trained there, over what
    the latter earns more than no action. ``flattery`` is the reward on its own backend less that on the reference.
    ``failed`` counts episodes on the reference.
    """

    scene: str
    policy: str
    trainings: int
    episodes: int
    wall_s: float
    processor_s: float
    seeds: int
    reference: float
    reference_half: float
    own: float
    own_half: float
    flattery: float
    flattery_half: float
    gap: float
    gap_half: float
    failed: int
    learner: str = CMA_ES


NUMBERS = [name for name, kind in get_type_hints(TransferRow).items() if kind is float]


def half_width(seeds: np.ndarray, *trainings: np.ndarray) -> float:
    """Half of the 95 % interval of a mean that varies with ``seeds`` ``(S,)`` and with ``trainings`` ``(R,)`` each.

    Variances of the means add up; Student's t with the degrees of freedom of Welch and Satterthwaite.
    """
    parts = [(x.var(ddof=1) / len(x), len(x) - 1) for x in (seeds, *trainings) if len(x) > 1]
    variance = sum(v for v, _ in parts)
    if variance == 0:
        return 0.0
    freedom = variance**2 / sum(v**2 / n for v, n in parts)
    return float(student.ppf(0.975, freedom) * np.sqrt(variance))


def summaries(trainings: Sequence[TrainingRow], episodes: Sequence[EpisodeRow]) -> list[TransferRow]:
    """One row for each scene, learner and policy of one resolution; what a stopped run left unfinished is passed over.

    No action and random actions are told once, as of the learner that comes first.
    """
    rewards: dict[tuple[str, str, str, str], dict[tuple[int, int], float]] = {}
    for e in episodes:
        rewards.setdefault((e.scene, e.learner, e.policy, e.scored_on), {})[e.repetition, e.seed] = e.reward
    scores = {}
    for key, found in rewards.items():
        rows, cols = (sorted({k[i] for k in found}) for i in (0, 1))
        if len(found) == len(rows) * len(cols):
            scores[key] = np.array([[found[row, col] for col in cols] for row in rows])  # (R, S)
    out = []
    for scene, learner, policy in dict.fromkeys((e.scene, e.learner, e.policy) for e in episodes):
        keys = [(scene, learner, p, REFERENCE) for p in (policy, REFERENCE)] + [(scene, CMA_ES, ZERO, REFERENCE)]
        if not set(keys) <= scores.keys():
            continue
        there, best, nothing = (scores[key] for key in keys)
        own = scores.get((scene, learner, policy, policy), there)
        scale = best.mean() - nothing.mean()
        gap_half = half_width(there.mean(0) - best.mean(0), there.mean(1), best.mean(1)) / abs(scale)
        gap = (there.mean() - best.mean()) / scale, gap_half if policy != REFERENCE else 0.0
        mine = [t for t in trainings if (t.scene, t.learner, t.policy) == (scene, learner, policy)]
        times = [np.median([getattr(t, name) for t in mine]) if mine else 0.0 for name in ("wall_s", "processor_s")]
        means = [x for r in (there, own, own - there) for x in (r.mean(), half_width(r.mean(0), r.mean(1)))]
        values = zip(NUMBERS, (*times, *means, *gap), strict=True)
        numbers: dict[str, Any] = {name: float(f"{value:.4g}") for name, value in values}
        played = [e for e in episodes if (e.scene, e.learner, e.policy, e.scored_on) == (*keys[0][:3], REFERENCE)]
        count, failed = mine[0].episodes if mine else 0, sum(e.failed for e in played)
        row = TransferRow(
            scene, policy, len(mine), count, seeds=there.shape[1], failed=failed, learner=learner, **numbers
        )
        out.append(row)
    return out


def table(rows: Sequence[TransferRow]) -> str:
    """Rewards per frame, one line a policy."""
    lines = []
    for scene in dict.fromkeys(r.scene for r in rows):
        lines.append(
            f"\n{scene:34s}{'episodes':>9s}{'seconds':>9s}{'on the reference':>18s}{'on its own':>16s}{'flattery':>18s}"
            f"{'gap':>16s}"
        )
        for r in (r for r in rows if r.scene == scene):
            trained = f"{r.episodes:9d}{r.processor_s:9.2f}" if r.trainings else " " * 18
            there, own = f"{r.reference:.3f} ± {r.reference_half:.3f}", f"{r.own:.3f} ± {r.own_half:.3f}"
            flattery, gap = f"{r.flattery:+.3f} ± {r.flattery_half:.3f}", f"{r.gap:+.2f} ± {r.gap_half:.2f}"
            if r.policy in (REFERENCE, ZERO, RANDOM):
                own = flattery = ""
            bad = f"  {r.failed} failed" if r.failed else ""
            name = f"{r.policy}, {r.learner}" if r.trainings else r.policy
            lines.append(f"{name:34s}{trained}{there:>18s}{own:>16s}{flattery:>18s}{gap:>16s}{bad}")
    return "\n".join(lines)


def panel(axes: Any, rows: Sequence[TransferRow], colors: Mapping[str, str]) -> dict[str, Any]:
    """One scene; returns the legend's entries."""
    handles: dict[str, Any] = {}
    axes.set_xscale("log")
    trained = [r for r in rows if r.trainings]
    times = np.array([r.processor_s for r in trained])
    left, right = np.log10(limits(times.min(), times.max(), 0.08))
    places = 10 ** spread(np.log10(times), APART * (right - left))
    for x, r in zip(places, trained, strict=True):
        name, _, rest = r.policy.partition(" x")
        color, marker = colors[name], MARKERS.get(rest, "X")
        size = 9 if marker == "*" else 6
        if r.policy != REFERENCE:
            axes.plot([x] * 2, [r.reference, r.own], color=color, lw=0.8, alpha=0.5, zorder=2)
            axes.plot(x, r.own, marker, ms=0.75 * size, mfc="white", mec=color, mew=1.0, zorder=5)
        handles[r.policy] = axes.errorbar(
            x, r.reference, yerr=r.reference_half, fmt=marker, color=color, ms=size, mec="white", mew=0.7,
            elinewidth=1.1, capsize=2.5, zorder=4,
        )  # fmt: skip
    for r in (r for r in rows if r.policy in FLOORS):
        handles[r.policy] = axes.axhline(r.reference, color=SOFT, ls=FLOORS[r.policy], lw=1.0, zorder=1)
    axes.set(xlim=(10**left, 10**right), ylim=(0, 1.08 * max(max(r.reference + r.reference_half, r.own) for r in rows)))
    axes.set_xticks([tick for tick in TICKS if 10**left <= tick <= 10**right])
    return handles


def draw(rows: Mapping[str, Sequence[TransferRow]], folder: Path, setup: str) -> None:
    """A panel a scene and learner: reward on the reference against training time."""
    mine = rows.get(STEM, ())
    shown = list(dict.fromkeys((r.scene, r.learner) for r in mine if r.trainings))
    if not shown:
        return
    figure, panels = grid(len(shown), "mean reward per frame")
    others = dict.fromkeys(r.policy.partition(" x")[0] for r in mine if r.trainings)  # some that --backend named
    colors = {name: COLORS[i % len(COLORS)] for i, name in enumerate(others)} | KNOWN
    handles: dict[str, Any] = {}
    for axes, (scene, learner) in zip(panels, shown, strict=False):
        there = [r for r in mine if r.scene == scene and (r.learner == learner or not r.trainings)]
        handles |= panel(axes, there, colors)
        episodes = min(r.episodes for r in there if r.trainings)
        dress(axes, f"{scene}, {learner}, {episodes} episodes")
    if len(panels) > len(shown):
        legend(panels[-1], handles, (), "center left", 1)
    else:
        legend(figure, handles, (), "outside upper center", 4)
    figure.supxlabel("processor time of a training, one thread [s]", fontsize=8.5, color=INK)
    save(figure, f"{setup}. {NOTE}", folder, STEM)
