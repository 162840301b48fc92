"""Rows of ``minicloth bench long-runs``, made of two sets of episodes, and their tables."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import wasserstein_distance

from training.bench.long_runs.episodes import TERMS, Episodes
from training.bench.participants import NUDGED
from training.metrics.spectra import BANDS, apart
from training.rows import rounded

FINE = BANDS // 8  # the first band of what is finer than an eighth of the Nyquist limit
STILL = 1e-3  # of the cloth's length (a second): the least standard deviation, of keypoints that hardly move
Key = tuple[str, str, str, str]  # scene, backend, options, actions


@dataclass(frozen=True)
class LongRow:
    """Episodes of one scene and backend under actions of one kind beside the reference's, equal seeds and actions.

    Distances are Wasserstein-1, over time and episodes together, in standard deviations of the reference's. The row of
    the nudged reference is every column's floor: how far the reference is from itself.

    Attributes:
        episodes, ended: those that lived here and in both runs of the reference, which are compared; those that failed.
        height: difference of the mean heights, in standard deviations. bending, kinetic, strain: ratios of means.
        height_apart, bending_apart, kinetic_apart, strain_apart: distances.
        observed, observed_worst, worst: mean and largest distance over the observation's components that the cloth
            decides, and which one that is.
        fresh: mean distance of observations from *other* episodes of the reference, over that of the nudged reference
            from them: 1 for who can't be told from the reference by half as many episodes of each.
        reward, reward_error: mean reward a frame less the reference's, and its standard error over episodes.
        space, time: distances of spectra [dB]: of curvature along rows finer than an eighth of the Nyquist limit, and
            of motion.
    """

    scene: str
    backend: str
    options: str
    actions: str
    episodes: int
    ended: int
    height: float
    bending: float
    kinetic: float
    strain: float
    height_apart: float
    bending_apart: float
    kinetic_apart: float
    strain_apart: float
    observed: float
    observed_worst: float
    worst: str
    fresh: float
    reward: float
    reward_error: float
    space: float
    time: float


@dataclass(frozen=True)
class SpectrumRow:
    """The power in one band: of curvature in ``space``, ``at`` a part of the Nyquist limit [1/m^2], or in ``time``,
    ``at`` a frequency [Hz], [m^2/s^2/Hz].
    """

    scene: str
    backend: str
    options: str
    actions: str
    kind: str
    at: float
    power: float


def distances(run: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Wasserstein-1 distance of every component, ``(D,)`` of ``(T, B, D)``."""
    flat = [part.reshape(-1, part.shape[-1]).T for part in (run, truth)]
    return np.array([wasserstein_distance(a, b) for a, b in zip(*flat, strict=True)])


def seen(runs: Sequence[Episodes], good: np.ndarray, length: float) -> tuple[np.ndarray, list[np.ndarray]]:
    """Numbers of the components that the cloth of ``length`` [m] decides, and what every run observed of them.

    The others, of actions alone, are equal in the last two runs, the reference's. Each is in standard deviations of
    these two together, or in ``STILL`` where it hardly moves, ``(T, episodes, components)``.
    """
    free = np.flatnonzero((runs[-1].observed != runs[-2].observed).any((0, 1)))
    parts = [run.observed[:, good][..., free].astype(np.float64) for run in runs]
    scale = np.maximum(np.concatenate(parts[-2:]).std((0, 1)), STILL * length)
    return free, [part / scale for part in parts]


def compare(key: Key, run: Episodes, truth: Episodes, nudged: Episodes, names: Sequence[str], length: float) -> LongRow:
    """The row of ``key``: scene, backend, options, actions.

    ``names`` are those of an observation's components, ``length`` [m] the cloth's.
    """
    good = ~(run.ended | truth.ended | nudged.ended)
    count, ended = int(good.sum()), int(run.ended.sum())
    if count < 2:
        nothing: dict[str, Any] = dict.fromkeys(list(LongRow.__dataclass_fields__)[6:], float("nan"))
        return LongRow(*key, count, ended, **nothing | {"worst": ""})
    told: dict[str, Any] = {}
    for name in TERMS:
        mine, true = run.terms[name][:, good], truth.terms[name][:, good]
        scale = true.std()
        told[name] = (mine.mean() - true.mean()) / scale if name == "height" else mine.mean() / true.mean()
        told[f"{name}_apart"] = wasserstein_distance(mine.ravel(), true.ravel()) / scale
    free, (mine, true, other) = seen((run, truth, nudged), good, length)
    apart_by = distances(mine, true)
    halves = (slice(None, None, 2), slice(1, None, 2))
    fresh, own = (sum(distances(x[:, a], true[:, b]).mean() for a, b in (halves, halves[::-1])) for x in (mine, other))
    gain = (run.rewards - truth.rewards)[:, good].mean(0)
    told |= {
        "observed": apart_by.mean(), "observed_worst": apart_by.max(), "fresh": fresh / own,
        "reward": gain.mean(), "reward_error": gain.std(ddof=1) / np.sqrt(count),
        "space": apart(run.space[FINE:, good].mean(1), truth.space[FINE:, good].mean(1)),
        "time": apart(run.time[:, good].mean(1), truth.time[:, good].mean(1)),
    }  # fmt: skip
    worst = names[free[apart_by.argmax()]]
    told = {name: float(value) for name, value in told.items()}
    return rounded(LongRow(*key, count, ended, worst=worst, **told))


def spectra(key: Key, run: Episodes, frame_dt: float) -> list[SpectrumRow]:
    """The spectra of ``key``, of the episodes that lived."""
    found = {
        "space": ((np.arange(BANDS) + 0.5) / BANDS, run.space),
        "time": ((np.arange(BANDS) + 1) / (2 * BANDS * frame_dt), run.time),
    }
    means = {kind: (at, power[:, ~run.ended].mean(1)) for kind, (at, power) in found.items() if not run.ended.all()}
    return [
        rounded(SpectrumRow(*key, kind, float(a), float(p)))
        for kind, (at, power) in means.items()
        for a, p in zip(at, power, strict=True)
    ]


def table(rows: Sequence[LongRow]) -> str:
    """A line a scene, kind of action and backend."""
    heads = ("height", "bending", "kinetic", "strain", "obs.", "worst", "fresh", "reward", "+-", "space", "time")
    lines = [f"{'':48s}{'ended':>6s}" + "".join(f"{head:>9s}" for head in heads)]
    for r in rows:
        numbers = (
            *(r.height, r.bending, r.kinetic, r.strain, r.observed, r.observed_worst, r.fresh),
            *(r.reward, r.reward_error, r.space, r.time),
        )
        name = f"{r.scene:11s}{r.actions:11s}{r.backend:26s}"
        lines.append(f"{name}{r.ended:6d}" + "".join(f"{number:9.3f}" for number in numbers) + f"  {r.worst}")
    return "\n".join(lines)


def summary(rows: Sequence[LongRow]) -> str:
    """A line a scene and backend: means over kinds of action; of observations over the floor also the largest."""
    floors = {(r.scene, r.actions): r.observed for r in rows if r.backend == NUDGED}
    names = ("fresh", "bending", "kinetic", "strain", "space", "time")
    head = f"{'':37s}{'obs. / floor':>14s}{'largest':>9s}"
    lines = [head + "".join(f"{name:>9s}" for name in names) + f"{'|reward|, largest':>19s}"]
    for scene, backend in dict.fromkeys((r.scene, r.backend) for r in rows):
        mine = [r for r in rows if (r.scene, r.backend) == (scene, backend)]
        over = [r.observed / floors.get((scene, r.actions), np.nan) for r in mine]
        means = "".join(f"{np.mean([getattr(r, name) for r in mine]):9.2f}" for name in names)
        reward = max(abs(r.reward) for r in mine)
        lines.append(f"{scene:11s}{backend:26s}{np.mean(over):14.2f}{max(over):9.2f}{means}{reward:19.3f}")
    return "\n".join(lines)
