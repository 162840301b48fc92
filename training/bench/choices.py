"""``minicloth bench choices``: the table by which ``backend="auto"`` chooses, and whether its choices hold.

Every candidate plays episodes. The reference goes on from its cloth at some of their frames, under the same controls,
and is held against it after 1, 5, 10 and 25 frames: what ``verify=`` measures. Actions are those of the table and, of
other seeds, of kinds that are not in it. ``--table FOLDER`` writes ``auto.json`` from the rows.
"""

import argparse
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cloth_envs.files import write_text
from cloth_envs.policies import CONTROLLERS
from cloth_envs.progress import progress
from cloth_envs.registry import load_task, make_backend
from cloth_envs.world import World
from surrogates.auto.table import HORIZONS, MARGIN
from training.bench.benchmark import Benchmark, Part, RowFile, Session
from training.bench.clock import CostRow, costs
from training.bench.measure import Windows, built, failed_by
from training.bench.participants import CHOICES, FLOOR, Participant, extra, label
from training.metrics.errors import vertex_error
from training.rollouts import Recording, nudge, record, replay, seeded_actions
from training.rows import rounded

STEM, COST = "choices", "choices_cost"
CONTROLLER = "controller"  # the scene's hand controller
# What the table is made of, and what it is checked on: policies, and the seeds of each.
SPLITS: dict[str, dict[str, Sequence[int]]] = {
    "table": {policy: range(1100, 1104) for policy in ("smooth", "random", "bang-bang", "alternating")},
    "held out": {policy: range(1220, 1224) for policy in ("zero", CONTROLLER, "bang-bang")},
}
STARTS = (10, 45, 80, 115)  # frames of an episode, at which windows begin
TOLERANCES = (0.3, 1.0, 3.0)  # % of the length
FLOORED = Participant(FLOOR)


@dataclass(frozen=True)
class ChoiceRow:
    """How far a candidate's own run is from the reference ``frames`` after that began at its cloth [% of the length].

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


def played(one: Participant, scene: str, policy: str, seeds: Sequence[int], starts: Sequence[int]) -> Recording:
    """Episodes of ``one`` under a policy or the scene's hand controller, with the states that are compared."""
    world = World(scene, num_envs=len(seeds), backend=one.backend, backend_kwargs=one.whole)
    frames = max(starts) + HORIZONS[-1]
    if policy == CONTROLLER:
        actions: Iterable[np.ndarray] = (CONTROLLERS[scene](world.observe()) for _ in range(frames))
    else:
        actions = seeded_actions(world, seeds, [policy], frames)
    return record(world, actions, [start + ahead for start in starts for ahead in (0, *HORIZONS)], seeds=seeds)


def distances(one: Participant, run: Recording, starts: Sequence[int]) -> dict[int, np.ndarray]:
    """Mean distance [% of the cloth's length] from the reference that goes on from the run's own cloth, of all windows.

    Infinite where the run had failed; for the chaos floor the reference goes on from a nudged cloth.
    """
    reference = make_backend("reference", run.scene, num_envs=len(run.materials))
    found: dict[int, list[np.ndarray]] = {frames: [] for frames in HORIZONS}
    for start in starts:
        begin = nudge(run.states[start], run.scene, start) if one.family == FLOOR else run.states[start]
        controls = run.controls[start : start + HORIZONS[-1]]
        for frame, (true, _) in enumerate(replay(reference, begin, controls, run.materials), 1):
            if frame in found:
                mine = run.states[start + frame].positions
                gone = np.array([failed_by(reason, start + frame) for reason in run.failures])
                error = vertex_error(mine, true.positions, run.scene.grid.length).mean
                found[frame].append(np.where(gone, np.inf, error))
    return {frames: np.concatenate(values) for frames, values in found.items()}


def errors(one: Participant, scene: str, split: str, policy: str, *, quick: bool) -> list[ChoiceRow]:
    """A row for each horizon."""
    few = 1 if quick else None
    seeds, starts, rows = SPLITS[split][policy][:few], STARTS[:few], []
    for frames, values in distances(one, played(one, scene, policy, seeds, starts), starts).items():
        within = json.dumps([round(float((values <= most).mean()), 3) for most in TOLERANCES])
        middle, high, largest = (float(v) for v in np.quantile(values, (0.5, 0.95, 1), method="higher"))
        name = scene, one.family, one.text, split, policy, frames, len(values)
        rows.append(rounded(ChoiceRow(*name, middle, high, largest, within)))
    return rows


def times(session: Session) -> None:
    """Times of a frame that are missing."""
    store, everyone = session.store(COST), [*CHOICES, *extra(session.given.backend)]
    for scene in progress(session.scenes, "times", unit="scene"):
        if any((scene, one.family, one.text) not in store for one in everyone):
            run = played(CHOICES[0], scene, "bang-bang", SPLITS["table"]["bang-bang"][:1], STARTS[2:3])
            controls = run.controls[STARTS[2] : STARTS[2] + HORIZONS[-1]]
            windows = Windows(run.scene, (0,), STARTS[2:3], controls, [run.states[STARTS[2]]], "")
            store.add(*costs(everyone, windows, runs=3 if session.quick else 11))


def measure(session: Session) -> None:
    """Errors of every scene, kind of action and candidate that are missing, and the table."""
    store, everyone = session.store(STEM), [*CHOICES, FLOORED, *extra(session.given.backend)]
    cells = [(scene, split, policy) for scene in session.scenes for split in SPLITS for policy in SPLITS[split]]
    for scene, *of in progress(cells, STEM, name=" ".join):
        for one in everyone:
            refused = isinstance(built(one, World(scene).scene), str)
            if not refused and (scene, one.family, one.text, *of, HORIZONS[0]) not in store:
                store.add(*errors(one, scene, *of, quick=session.quick))
    if session.given.table:
        write_table(session)


def options(parser: argparse.ArgumentParser) -> None:
    """Where the table goes."""
    parser.add_argument("--table", type=Path, help="folder for auto.json, the table made of the rows")


def table(rows: Sequence[ChoiceRow], prices: Sequence[CostRow]) -> dict[str, Any]:
    """By scene, what ``surrogates.auto`` reads: time, and the errors of the worst policy of the table."""
    found: dict[str, Any] = {}
    known = {(one.family, one.text): one for one in CHOICES}
    for price in prices:
        one, mine = known.get((price.family, price.options)), [r for r in rows if r.split == "table"]
        mine = [r for r in mine if (r.scene, r.family, r.options) == (price.scene, price.family, price.options)]
        floor = [r for r in rows if (r.scene, r.family, r.split) == (price.scene, FLOOR, "table")]
        if one is None or price.failure or not mine or not floor:
            continue
        task = load_task(price.scene)
        entry = found.setdefault(price.scene, {
            "measured on": {"resolution": task.resolution, "material": task.material.as_dict()},
            "floor": _worst(floor),
            "backends": [],
        })  # fmt: skip
        entry["backends"].append({
            "backend": one.backend, "options": one.whole, "ms": price.ms_median, "error": _worst(mine),
        })  # fmt: skip
    return found


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
