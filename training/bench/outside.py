"""``minicloth bench outside``: miniatures beyond what they were fitted on, beside the similar cloth.

Other materials, grids, presets: the default restarts from the reference and is held against it, and so are the similar
cloth and, whatever its card says, the closure with its network. Where the default takes a plainer cloth it tells.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import Any

import numpy as np

from cloth_envs.material import FABRICS
from cloth_envs.progress import progress
from cloth_envs.registry import PRESETS, load_task
from cloth_envs.world import World
from training.bench.benchmark import Benchmark, Part, RowFile, Session
from training.bench.participants import Participant, extra
from training.metrics.errors import vertex_error
from training.rollouts import Recording, record, replay, seeded_actions
from training.rows import rounded

STEM = "outside"
SEEDS = range(1410, 1413)  # policies take turns; where cards hold was chosen on others
POLICIES = ("smooth", "random", "bang-bang")
STARTS, FRAMES = (20, 50), (5, 10)
FACTORS = (2, 4)
QUICK = ("own", "leather", "areal_density x 4", "compression 0.5", "half the grid", "9 x 13")  # of the variants
SINGLE = ("areal_density", "stretch_stiffness", "shear_stiffness", "bend_stiffness", "damping")
METHODS: Mapping[str, dict[str, Any]] = {
    "default": {},
    "closure": {"scaling": "closure", "upscaler": "local"},
    "similar": {"scaling": "similar", "upscaler": "bicubic"},
}


@dataclass(frozen=True)
class OutsideRow:
    """Errors of the METHODS after ``frames`` [% of the cloth's length], NaN of one that refuses the scene.

    ``told`` is what ``info["surrogate"]`` says of the default; empty within the card. ``lost`` counts cloths that ended
    in the reference's run and were left out. ``others`` are errors of what ``--backend`` named, by its label, as JSON.
    """

    scene: str
    variant: str
    factor: int
    frames: int
    windows: int
    lost: int
    default: float
    closure: float
    similar: float
    told: str
    others: str = "{}"


def variants(scene: str) -> dict[str, dict[str, Any]]:
    """Arguments of ``World`` by name: what a cloth of ``scene`` can be beside the one that was fitted."""
    task = load_task(scene)
    rows, cols = task.resolution
    found: dict[str, dict[str, Any]] = {"own": {}}
    found |= {fabric: {"material": fabric} for fabric in FABRICS if fabric != "default"}
    found |= {
        f"{name} x {share:g}": {"material": {name: share * getattr(task.material, name)}}
        for name in SINGLE
        for share in (0.25, 4.0)
    }
    found |= {f"compression {c:g}": {"material": {"compression": c}} for c in (0.1, 0.5)}
    found |= {
        "half the grid": {"resolution": (rows // 2 + 1, cols // 2 + 1)},
        "twice the grid": {"resolution": (2 * rows - 1, 2 * cols - 1)},
        "9 x 13": {"resolution": (9, 13)},
    }
    return found | {
        preset: {"preset": preset} for preset in PRESETS if scene in PRESETS[preset] and preset == "lee2019"
    }


def windows(scene: str, options: Mapping[str, Any], seeds: Sequence[int], starts: Sequence[int]) -> Recording:
    """The reference's run of every seed."""
    world = World(scene, num_envs=len(seeds), **options)
    keep = [start + ahead for start in starts for ahead in (0, *FRAMES)]
    return record(world, seeded_actions(world, seeds, POLICIES, max(keep)), keep, seeds=seeds)


def errors(run: Recording, starts: Sequence[int], one: Participant) -> tuple[dict[int, float], str]:
    """Mean error after each of FRAMES, and what the backend tells."""
    found: dict[int, list[float]] = {frames: [] for frames in FRAMES}
    try:
        backend = one.build(run.scene, len(run.materials))
    except ValueError:
        return dict.fromkeys(FRAMES, float("nan")), ""
    for start in starts:
        steps = replay(backend, run.states[start], run.controls[start : start + max(FRAMES)], run.materials)
        for frame, (state, _) in enumerate(steps, 1):
            if frame in found:
                true = run.states[start + frame].positions
                found[frame].append(float(vertex_error(state.positions, true, run.scene.grid.length).mean.mean()))
    told = np.unique(getattr(backend, "surrogate", np.array([""])).astype(str))
    return {frames: fmean(values) for frames, values in found.items()}, "; ".join(filter(None, told.tolist()))


def measure(session: Session) -> None:
    """Every scene, variant and factor that is missing, or lacks one of ``--backend``."""
    store, others = session.store(STEM), extra(session.given.backend)
    seeds, starts = (SEEDS, STARTS[:1]) if session.quick else (SEEDS, STARTS)
    session.about |= {"seeds": list(seeds), "starts": starts, "actions": POLICIES}
    cells = [
        (scene, name, options)
        for scene in session.scenes
        for name, options in variants(scene).items()
        if name in QUICK or not session.quick
    ]
    labels = {one.label for one in others}
    for scene, name, options in progress(cells, STEM, name=lambda cell: f"{cell[0]} {cell[1]}"):
        rows = [r for r in store.rows if (r.scene, r.variant) == (scene, name)]
        there = {(r.factor, r.frames): json.loads(r.others) for r in rows}
        if len(there) == len(FACTORS) * len(FRAMES) and all(labels <= known.keys() for known in there.values()):
            continue
        run = windows(scene, options, seeds, starts)
        good = run.only(run.good)
        if not good.materials:
            continue
        apart = {one.label: errors(good, starts, one)[0] for one in others}
        for factor in FACTORS:
            methods = (Participant(key, "miniature", {"factor": factor, **given}) for key, given in METHODS.items())
            by = {one.family: errors(good, starts, one) for one in methods}
            for frames in FRAMES:
                default, closure, similar = (by[method][0][frames] for method in METHODS)
                count, lost = len(starts) * len(good.materials), len(run.failures) - len(good.materials)
                more = {label: float(f"{error[frames]:.5g}") for label, error in apart.items()}
                told = by["default"][1], json.dumps(there.get((factor, frames), {}) | more)
                row = scene, name, factor, frames, count, lost, default, closure, similar, *told
                store.add(rounded(OutsideRow(*row)))


def table(rows: Sequence[OutsideRow]) -> str:
    """A line a variant and factor: errors over the similar cloth's, scene by scene; * where the default tells."""
    scenes = list(dict.fromkeys(r.scene for r in rows))
    methods = " / ".join(["   default", "closure", *dict.fromkeys(name for r in rows for name in json.loads(r.others))])
    lines = [f"{'after 10 frames':28s}" + "".join(f"{scene:>20s}" for scene in scenes) + f"{methods} over similar"]
    for variant, factor in dict.fromkeys((r.variant, r.factor) for r in rows):
        cells = []
        for scene in scenes:
            mine = [r for r in rows if (r.scene, r.variant, r.factor, r.frames) == (scene, variant, factor, FRAMES[-1])]
            text = "-"
            for r in mine:
                more = (f" / {error / r.similar:.2f}" for error in (r.closure, *json.loads(r.others).values()))
                text = f"{r.default / r.similar:.2f}{'*' * bool(r.told)}{''.join(more)}"
            cells.append(f"{text:>20s}")
        lines.append(f"{variant:24s} x{factor:<2d} " + "".join(cells))
    worse = [r for r in rows if r.default > 1.005 * r.similar]
    lines.append(f"worse than similar: {len(worse)} of {len(rows)}")
    lines += [f"  {json.dumps([r.scene, r.variant, r.factor, r.frames, r.default, r.similar, r.told])}" for r in worse]
    return "\n".join(lines)


BENCHMARK = Benchmark(
    name=STEM,
    about="Errors of miniatures on materials, grids and presets that they were not fitted on, and what they tell.",
    files={STEM: RowFile(OutsideRow, ("scene", "variant", "factor", "frames"))},
    parts=[Part("Over the similar cloth's error", (STEM,), table)],
    measure=measure,
)
