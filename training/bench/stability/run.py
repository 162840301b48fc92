"""``minicloth bench stability``: where methods fail. Frames, materials, wind, bodies, grids, long and wild runs.

Every backend runs the same worlds, a few levels along each axis; its runs are compared with the truth of the same
world and each failure names its reason. Rows that are in --out already are kept; --fresh measures again.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

from tqdm import tqdm

from cloth_envs.machine import header
from cloth_envs.registry import SCENES
from training.bench.speed_accuracy.run import revision
from training.bench.stability import chart as stability_chart
from training.bench.stability.rows import KEY, Cell, Place, table
from training.bench.stability.runs import BUDGETED, BURST, TRUTH, build, run, truths
from training.bench.stability.scores import ASTRAY, DRIFT, EARLY, GAINED, HEIGHT, SOFT, SPARE, score
from training.bench.stability.worlds import AXES, DURATION, Base
from training.bench.verdict import GATE, LIVELY, STRAINED
from training.bench.windows import rounded
from training.rows import Store, read_names, read_rows

SEEDS, QUICK_SEEDS = (300, 301, 302, 303, 304), (300,)  # held out: the miniature was calibrated on 100..103
QUICK = 2  # grids are so many times coarser


@dataclass(frozen=True)
class Method:
    """A backend with its options, on a grid ``coarse`` times coarser than the scene's where it is too slow for that."""

    backend: str
    options: Mapping[str, Any]
    coarse: int = 1

    @property
    def text(self) -> str:
        """The options as JSON, for a row."""
        return json.dumps(dict(self.options))


def _miniature(factor: int, scaling: str, **options: object) -> Method:
    return Method("miniature", {"factor": factor, "scaling": scaling, **options})


# Add a method by a line.
METHODS: dict[str, Method] = {
    "explicit": Method("reference", {"solver": "explicit"}),
    "P-ADMM, 10 it.": Method("reference", {"solver": "admm", "iterations": 10}),
    "implicit, 1/4 grid": Method("reference", {"solver": "implicit", "max_iterations": 100}, 4),
    "mini \u00d72 similar": _miniature(2, "similar"),
    "mini \u00d72 calibrated": _miniature(2, "calibrated"),
    "mini \u00d74 similar": _miniature(4, "similar"),
    "mini \u00d74 calibrated": _miniature(4, "calibrated"),
    "mini \u00d72 closure, local": _miniature(2, "closure", upscaler="local"),
    "mini \u00d74 closure, local": _miniature(4, "closure", upscaler="local"),
    "mini \u00d74 guarded": _miniature(4, "closure", upscaler="local", guard=True),
    "mini \u00d74 learned": _miniature(4, "closure", correction="learned"),
    "cnn": Method("cnn", {}),
}


def parser() -> argparse.ArgumentParser:
    top = argparse.ArgumentParser(prog="minicloth bench stability", description=__doc__)
    top.add_argument("--scenes", help="default: Curtain and Flag, and those that an axis belongs to")
    top.add_argument("--axes", default=",".join(AXES), help="default: all, " + ", ".join(AXES))
    top.add_argument("--quick", action="store_true", help="one seed, coarse grids, ends of the axes; says so")
    top.add_argument("--out", type=Path, help="folder for rows (CSV), their header (JSON) and the chart")
    top.add_argument("--images", type=Path, help="another folder for the chart")
    top.add_argument("--chart-only", action="store_true", help="draw what --out holds, measure nothing")
    top.add_argument("--fresh", action="store_true", help="measure again what --out holds")
    return top


class World(NamedTuple):
    """One world, but for its grid."""

    axis: str
    level: float
    scene: str
    seed: int


def worlds(scenes: Sequence[str] | None, axes: Sequence[str], seeds: Sequence[int], *, ends: bool) -> list[World]:
    """Every world in ``scenes`` (default: each axis's usual ones), seed by seed; of the axes only the ``ends``."""
    return [
        World(name, level, scene, seed)
        for seed in seeds
        for name in axes
        for scene in AXES[name].of(scenes)
        for level in AXES[name].runs(ends=ends)
    ]


def missing(store: Store[Cell], world: World, methods: Mapping[str, Method]) -> dict[str, Method]:
    """The ``methods`` that ``store`` lacks in ``world``."""
    return {
        label: m
        for label, m in methods.items()
        if (world.axis, world.level, world.scene, label, m.text, world.seed) not in store
    }


def cells(world: World, methods: Mapping[str, Method], coarse: int) -> list[Cell]:
    """Run ``methods`` in ``world`` on a grid ``coarse`` times coarser, and its truth."""
    axis = AXES[world.axis]
    stage = axis.make(Base(world.scene, world.seed, coarse), world.level)
    true, near = truths(stage, world.seed)
    out = []
    for label, method in methods.items():
        found = run(build(method.backend, dict(method.options), stage.scene), stage)
        for level, frames in axis.marks(world.level, len(stage.controls)):
            place = Place(
                world.axis, level, world.scene, label, method.text, *stage.scene.grid.shape, stage.scene.frame_dt,
                world.seed,
            )  # fmt: skip
            out.append(Cell(**asdict(place), **asdict(rounded(score(found, true, near, frames)))))
    return out


def measure(store: Store[Cell], todo: Sequence[World], coarse: int = 1) -> None:
    """Fill in what ``store`` lacks of the worlds ``todo``, on grids ``coarse`` times coarser."""
    bar = tqdm(todo, desc="stability", disable=None)
    for world in bar:
        bar.set_postfix_str(f"{world.scene} {world.axis} {AXES[world.axis].label(world.level)}")
        for grid in dict.fromkeys(m.coarse for m in METHODS.values()):
            mine = missing(store, world, {label: m for label, m in METHODS.items() if m.coarse == grid})
            if mine:
                store.add(*cells(world, mine, grid * coarse))


def main(argv: list[str] | None = None) -> int:
    given = parser().parse_args(argv)
    scenes = None if given.scenes is None else read_names(given.scenes, list(SCENES), "scene")
    axes = read_names(given.axes, list(AXES), "axis")
    out, quick = given.out, given.quick
    if given.chart_only:
        if out is None:
            raise ValueError("--chart-only needs --out, the folder that holds the rows")
        draw(
            read_rows(out / "stability.csv", Cell),
            given.images or out,
            json.loads((out / "stability.json").read_text()),
        )
        return 0
    old = out / "stability.json" if out else None
    if old and old.is_file() and not given.fresh and json.loads(old.read_text())["quick"] != quick:
        raise ValueError(f"{out} holds rows {'without' if quick else 'of'} --quick: choose another --out, or --fresh")
    seeds = QUICK_SEEDS if quick else SEEDS
    about = {
        **header(),
        "revision": revision(),
        "quick": quick,
        "threads": 1,
        "omp_num_threads": os.environ.get("OMP_NUM_THREADS", "unset"),
        "seeds": seeds,
        "seconds": DURATION,
        "grid": f"the scene's, {QUICK} times coarser" if quick else "the scene's",
        "coarser": {label: m.coarse for label, m in METHODS.items() if m.coarse > 1},
        "truth": f"explicit, float32, half the stable step, on each method's own grid: {TRUTH}",
        "soft": SOFT,
        "fails": {
            "blow-up": f"a value that is not finite, or an edge at {BURST:g} times its length",
            "overstretch": "an edge at twice its length",
            "energy": f"200 J/kg gained in a frame, or kinetic over {LIVELY:g} times the truth's + {SPARE:g} J/kg",
            "tunnelling": "a vertex or triangle that a body went through",
            "momentum": f"drift over {DRIFT:g} of the sum of m |v|, with no force from outside",
            "slow motion, fast motion": f"mean height off by over {HEIGHT:g} of its way within {GATE:g} s, and by "
            "twice the difference that a nudge of a millionth makes",
            "error": f"vertices off by over {ASTRAY:g} of the length after {EARLY:g} s",
            "strained": f"p99 strain over {STRAINED:g} times the truth's + 0.05",
            "energy drift": f"{GAINED:g} m g H from nowhere in {BUDGETED} frames beyond what the truth's budget leaves",
            "refused": "the backend can't; its words",
        },
    }
    print(
        f"{about['processor']}, {about['cores']} cores{', quick: coarse grids, 1 seed, ends of axes' if quick else ''}"
    )
    if out:
        out.mkdir(parents=True, exist_ok=True)
        (out / "stability.json").write_text(json.dumps(about, indent=2))
    store = Store(out / "stability.csv" if out else None, Cell, KEY, fresh=given.fresh)
    measure(store, worlds(scenes, axes, seeds, ends=quick), QUICK if quick else 1)
    print(table(store.rows))
    if out:
        draw(store.rows, given.images or out, about)
        print(f"rows in {out}")
    return 0


def draw(rows: Sequence[Cell], folder: Path, about: Mapping[str, Any]) -> None:
    """The heat maps."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"stability.{kind}" for kind in ("png", "svg")]
    stability_chart.draw(rows, paths, seeds=len(about["seeds"]), quick=about["quick"])
