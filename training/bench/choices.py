"""``minicloth bench choices``: the table by which ``backend="auto"`` chooses, and whether its choices hold.

Every candidate restarts from the reference and is held against it after 1, 5, 10 and 25 frames, under the actions of
the table and, of other seeds, of kinds that are not in it. ``--table FOLDER`` writes ``auto.json`` from the rows.
"""

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cloth_envs.files import write_text
from cloth_envs.progress import progress
from cloth_envs.registry import load_task
from surrogates.auto.table import HORIZONS, MARGIN
from training.bench.benchmark import Benchmark, Part, RowFile, Session
from training.bench.clock import CostRow, costs
from training.bench.measure import Windows, failed_by, follow, gather
from training.bench.participants import CHOICES, Participant, extra, label, truth
from training.metrics.errors import vertex_error
from training.rows import rounded
from training.truth import CONTROLLER, Case

STEM, COST = "choices", "choices_cost"
# What the table is made of, and what it is checked on: policies, and the seeds of each.
SPLITS: dict[str, dict[str, Sequence[int]]] = {
    "table": {policy: range(1100, 1104) for policy in ("smooth", "random", "bang-bang", "alternating")},
    "held out": {policy: range(1210, 1214) for policy in ("zero", CONTROLLER, "bang-bang")},
}
STARTS = (10, 45, 80, 115)  # frames of an episode, at which windows begin
TOLERANCES = (0.3, 1.0, 3.0)  # % of the length
FLOORED = truth("plain")


@dataclass(frozen=True)
class ChoiceRow:
    """Errors of a candidate, ``frames`` after it was restarted from the reference [% of the cloth's length].

    ``median``, ``q95`` and ``largest`` are of all windows of a policy; ``within`` are the shares of the windows within
    the TOLERANCES, as JSON. Failed windows have an infinite error.
    """

    scene: str
    family: str
    options: str
    split: str
    policy: str
    frames: int
    windows: int
    median: float
    q95: float
    largest: float
    within: str


def errors(one: Participant, windows: Windows, split: str, policy: str) -> list[ChoiceRow]:
    """A row for each horizon."""
    found, rows = follow(one, windows), []
    for frames in HORIZONS:
        gone = np.array([failed_by(reason, frames) for reason in found.failures])
        values = np.full(len(gone), np.inf)
        if not gone.all():
            mine, true = found.states[frames].positions, windows.truth[frames].positions
            values[~gone] = vertex_error(mine[~gone], true[~gone], windows.scene.grid.length).mean
        within = json.dumps([round(float((values <= most).mean()), 3) for most in TOLERANCES])
        middle, high, largest = (float(v) for v in np.quantile(values, (0.5, 0.95, 1), method="higher"))
        name = windows.scene.name, one.family, one.text, split, policy, frames, len(values)
        rows.append(rounded(ChoiceRow(*name, middle, high, largest, within)))
    return rows


def gathered(session: Session, scene: str, split: str, policy: str) -> Windows:
    """The windows of a scene, split and policy, restarted from the reference in float64."""
    few = 1 if session.quick else None
    cases = [Case(scene, seed, truth="plain", actions=policy) for seed in SPLITS[split][policy][:few]]
    keep = [start + frame for start in STARTS[:few] for frame in range(HORIZONS[-1] + 1)]
    return gather(cases, STARTS[:few], HORIZONS[-1], keep, session.cache("truth"))


def times(session: Session) -> None:
    """Times of a frame that are missing."""
    store, everyone = session.store(COST), [*CHOICES, *extra(session.given.backend)]
    for scene in progress(session.scenes, "times", unit="scene"):
        if any((scene, one.family, one.text) not in store for one in everyone):
            windows = gathered(session, scene, "table", "bang-bang")
            store.add(*costs(everyone, windows, runs=3 if session.quick else 11))


def measure(session: Session) -> None:
    """Errors of every scene, kind of action and candidate that are missing, and the table."""
    store, everyone = session.store(STEM), [*CHOICES, FLOORED, *extra(session.given.backend)]
    cells = [(scene, split, policy) for scene in session.scenes for split in SPLITS for policy in SPLITS[split]]
    for cell in progress(cells, STEM, name=" ".join):
        scene, *of = cell
        todo = [one for one in everyone if (scene, one.family, one.text, *of, HORIZONS[0]) not in store]
        if todo:
            windows = gathered(session, *cell)
            for one in todo:
                store.add(*errors(one, windows, *of))
    if session.given.table:
        write_table(session)


def options(parser: argparse.ArgumentParser) -> None:
    """Where the table goes."""
    parser.add_argument("--table", type=Path, help="folder for auto.json, the table made of the rows")


def table(rows: Sequence[ChoiceRow], prices: Sequence[CostRow]) -> dict[str, Any]:
    """By scene, what ``surrogates.auto`` reads: time, and the errors of the worst policy of the table."""
    found: dict[str, Any] = {}
    for price in (p for p in prices if not p.failure):
        mine = [r for r in rows if (r.scene, r.family, r.options, r.split) == (*_of(price), "table")]
        task = load_task(price.scene)
        floor = [r for r in rows if (r.scene, r.family, r.split) == (price.scene, FLOORED.family, "table")]
        entry = found.setdefault(price.scene, {
            "measured on": {"resolution": task.resolution, "material": task.material.as_dict()},
            "floor": _worst(floor),
            "backends": [],
        })  # fmt: skip
        one = next(p for p in CHOICES if (p.family, p.text) == (price.family, price.options))
        entry["backends"].append({
            "backend": one.backend, "options": one.whole, "ms": price.ms_median, "error": _worst(mine),
        })  # fmt: skip
    return found


def _of(price: CostRow) -> tuple[str, str, str]:
    return price.scene, price.family, price.options


def _worst(rows: Sequence[ChoiceRow]) -> dict[str, float]:
    return {str(h): max(r.q95 for r in rows if r.frames == h) for h in HORIZONS}


def write_table(session: Session) -> None:
    """``auto.json`` of all rows."""
    found = table(session.store(STEM).rows, session.store(COST).rows)
    about = {**session.about, "errors": "95 % of the windows, worst kind of action [% of the cloth's length]"}
    write_text(session.given.table / "auto.json", json.dumps({"scenes": found, "about": about}, indent=1) + "\n")


def checked(rows: Sequence[ChoiceRow], prices: Sequence[CostRow]) -> str:
    """What the table chooses for every tolerance, and how many of the held-out windows are within it."""
    head = f"{'scene':10s} {'frames':>6s} {'tolerance':>9s}  {'chosen':24s} {'ms':>6s} {'faster':>7s} {'within':>8s}"
    lines = [head]
    for scene, entry in table(rows, prices).items():
        usual = next(p.ms_median for p in prices if (p.scene, p.family) == (scene, "explicit"))
        for frames in (5, 25):
            for k, most in enumerate(TOLERANCES):
                at = f"{scene:10s} {frames:6d} {most:9g}  "
                if most < (floor := entry["floor"][str(frames)]):
                    lines.append(f"{at}below the chaos floor of {floor:.2g} %")
                    continue
                held = [o for o in entry["backends"] if o["error"][str(frames)] * MARGIN <= most]
                reference: dict[str, Any] = {"backend": "reference", "options": CHOICES[0].whole, "ms": usual}
                chosen = min(held, key=lambda o: o["ms"], default=reference)
                one = next(p for p in CHOICES if (p.backend, p.whole) == (chosen["backend"], chosen["options"]))
                mine = [r for r in rows if (r.scene, r.family, r.options) == (scene, one.family, one.text)]
                held_out = [r for r in mine if (r.split, r.frames) == ("held out", frames)]
                share = np.average([json.loads(r.within)[k] for r in held_out], weights=[r.windows for r in held_out])
                ms, name = chosen["ms"], label(one.family, one.text)
                lines.append(f"{at}{name:24s} {ms:6.2f} {usual / ms:6.1f}x {100 * share:6.1f} %")
    return "\n".join(lines)


BENCHMARK = Benchmark(
    name=STEM,
    about="Which backend is the cheapest that holds a tolerance, and whether it does under other actions.",
    files={
        STEM: RowFile(ChoiceRow, ("scene", "family", "options", "split", "policy", "frames")),
        COST: RowFile(CostRow, ("scene", "family", "options")),
    },
    parts=[Part("What auto chooses, and the held-out windows within the tolerance", (STEM, COST), checked)],
    measure=measure,
    times=times,
    options=options,
)
