"""``minicloth generate SCENE --pairs synchronised``: a coarse cloth, and a fine one pulled along with it.

Of Draping, Hitting and Skirt the sequences of Chen et al. 2020 (``preset="chen2020"``, actions of zero), of other
scenes, and with ``--own`` of these too, the environment's grid and smooth actions. Each is two recordings, ``coarse``
and ``fine`` of ``train`` or ``test``; whole ones are kept.
"""

import errno
import json
import os
from collections import deque
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cloth_envs.files import cannot_write, write_bytes
from cloth_envs.locks import alone_in
from cloth_envs.parsing import Parser
from cloth_envs.presets import load_preset, presets_of
from cloth_envs.progress import announce, progress
from cloth_envs.recording import Rollout, RolloutWriter
from cloth_envs.registry import EPISODE_FRAMES, load_task
from cloth_envs.state import State
from cloth_envs.world import World
from surrogates.superres.synchronised import RATES, Synchronised
from training.jobs import each
from training.rollouts import record, seeded_actions
from training.superres.pairs import SPLITS, pairs_folder, place, twin

PRESET = "chen2020"
BACKEND = f"{Synchronised.__module__}:{Synchronised.__qualname__}"
STEPS = 2.0**-17, 2.0**-10  # to which cloths are rounded: 8 micrometres, 1 mm/s; files are 2.7 times smaller
RATE = {"Skirt": 44.0}  # 1/s of mean tracking; others have its usual one. Pleats have spikes where it is larger
USUAL = 13, 10  # sequences, and how many of them are for training, of scenes that the paper does not have


@dataclass(frozen=True)
class Plan:
    """What decides the pairs, but for how many sequences there are.

    Attributes:
        own: the environment's grid and smooth actions, not the paper's sequences.
    """

    scene: str
    frames: int
    factor: int = 4
    tracking: str = "mean"
    rate: float | None = None
    layout: int = 1
    own: bool = False

    @property
    def published(self) -> bool:
        """Whether the sequences are the paper's."""
        return not self.own and PRESET in presets_of(self.scene)

    @property
    def protocol(self) -> "Protocol":
        return Protocol.of(self.scene, self.own)

    @property
    def options(self) -> dict[str, Any]:
        """Those of ``Synchronised``."""
        return {"factor": self.factor, "tracking": self.tracking, "rate": self.rate}

    @classmethod
    def usual(cls, scene: str, frames: int, *, factor: int = 4, tracking: str = "mean", own: bool = False) -> "Plan":
        """With the rate that fits the scene."""
        return cls(scene, frames, factor, tracking, RATE.get(scene) if tracking == "mean" else None, own=own)

    def world(self, number: int) -> World:
        """That of a sequence: the paper's, where it has the scene, else the scene's at its own resolution."""
        preset = {"name": PRESET, "sequence": number} if self.published else None
        return World(self.scene, preset=preset, backend=BACKEND, backend_kwargs=self.options)

    def actions(self, world: World, number: int) -> np.ndarray:
        """None of the paper's sequences, smooth ones of other scenes; ``(frames, 1, A)``."""
        if self.published:
            return np.zeros((self.frames, 1, len(world.task.actions)))
        return seeded_actions(world, [number], ["smooth"], self.frames)


@dataclass(frozen=True)
class Protocol:
    """How many sequences of how many frames a scene has; the first ``trained`` are for training."""

    sequences: int
    trained: int
    frames: int

    @classmethod
    def of(cls, scene: str, own: bool = False) -> "Protocol":
        if own or PRESET not in presets_of(scene):
            return cls(*USUAL, EPISODE_FRAMES[scene])
        task = load_preset(scene, PRESET)
        return cls(task.sequences, task.trained, task.frames)  # type: ignore[attr-defined]

    def split(self, number: int) -> str:
        return SPLITS[number >= self.trained]

    def first(self, count: int) -> list[int]:
        """``count`` sequences, a quarter of them for testing, all that there are at most."""
        tests = min(-(-count // 4) if count > 1 else 0, self.sequences - self.trained)
        return [*range(min(count - tests, self.trained)), *range(self.sequences - tests, self.sequences)]


def write_sequence(plan: Plan, folder: Path, number: int) -> None:
    """Simulate one pair and store it; its files appear under their names when they are whole, the fine one last.

    Raises:
        ValueError: a simulation failed.
        OSError: it can't be written. Nothing is left of it then.
    """
    world = plan.world(number)
    actions = plan.actions(world, number)
    cloths = world.backend
    assert isinstance(cloths, Synchronised)
    fine = place(folder, plan.protocol.split(number), number)
    ends = twin(fine), fine
    parts = [end.with_name(f".{end.name}.part") for end in ends]
    for part in parts:
        part.parent.mkdir(parents=True, exist_ok=True)
        part.unlink(missing_ok=True)
    try:
        with ExitStack() as stack:
            scenes = cloths.coarse_scene, world.scene
            writers = [
                stack.enter_context(RolloutWriter(part, scene, actions=actions.shape[2], steps=STEPS))
                for part, scene in zip(parts, scenes, strict=True)
            ]
            for writer in writers:
                writer.begin(number)

            def store(state: State) -> State:
                action, reward = world.episode.action[0], float(world.rewards[0])
                for writer, cloth in zip(writers, (cloths.coarse, state), strict=True):
                    writer.append(cloth, action, reward)
                return state.select([])

            run = record(world, actions, range(plan.frames + 1), seeds=[number], take=store)
        if run.failures[0]:
            raise ValueError(f"sequence {number} of {plan.scene} failed ({run.failures[0]}): use other --tracking")
        for part, end in zip(parts, ends, strict=True):
            part.replace(end)
    except OSError as error:  # the writer's own tells of frames in parts, which are removed
        code = error.errno or errno.EIO
        raise cannot_write(fine, OSError(code, os.strerror(code))) from error
    finally:
        for part in parts:
            part.unlink(missing_ok=True)


def missing(plan: Plan, folder: Path, numbers: Sequence[int]) -> list[int]:
    """Which sequences are not there, or not whole.

    Raises:
        ValueError: the folder holds pairs of another plan.
    """
    text = json.dumps(asdict(plan))
    told = folder / "plan.json"
    if not told.is_file():
        write_bytes(told, text.encode())
    elif told.read_text(encoding="utf-8") not in (text, text.replace(', "own": false', "")):  # the latter is older
        raise ValueError(f"{folder} holds pairs of another plan: choose another --out, or remove it")
    split = plan.protocol.split

    def whole(path: Path) -> bool:
        try:
            with Rollout.open(path) as found:
                return found.lengths == [plan.frames + 1]
        except (ValueError, FileNotFoundError):
            return False

    return [n for n in numbers if not all(map(whole, (fine := place(folder, split(n), n), twin(fine))))]


def generate(plan: Plan, folder: Path, numbers: Sequence[int], jobs: int = 1, address: str | None = None) -> int:
    """Write what is missing of some sequences, over processes or the Ray cluster at ``address``. Returns how many.

    Raises:
        ValueError: the folder holds pairs of another plan, or a simulation failed.
        OSError: another program makes pairs there, or they can't be written.
        ImportError: an address, and no Ray.
    """
    with alone_in(folder):
        wanted = missing(plan, folder, numbers)
        written = each(partial(write_sequence, plan, folder), wanted, jobs, address)
        deque(progress(written, f"{plan.scene}, new sequences", len(wanted)), 0)
    return len(wanted)


def main(argv: Sequence[str] | None = None) -> int:
    """Write the pairs. Returns the exit code."""
    parser = Parser(prog="minicloth generate", description=__doc__)
    parser.add_argument("scene", metavar="SCENE")
    parser.add_argument("--pairs", choices=["synchronised"], required=True)
    parser.add_argument("--own", action="store_true", help="the environment's grid, not the paper's sequences")
    parser.add_argument("--sequences", type=int, help="how many, of training and for testing (default: the paper's)")
    parser.add_argument("--frames", type=int, help="of each (default: the paper's)")
    parser.add_argument("--factor", type=int, default=4, help="times fewer cells of the coarse cloth (default 4)")
    parser.add_argument("--tracking", choices=list(RATES), default="mean", help="what is pulled (default mean)")
    parser.add_argument("--jobs", type=int, default=1, help="processes (default 1)")
    parser.add_argument(
        "--ray", metavar="ADDRESS", help="of a Ray cluster that runs them instead, 'local' for one here"
    )
    parser.add_argument("--out", type=Path, help="folder of the files (default: in the user's cache)")
    given = parser.parse_args(argv)
    load_task(given.scene)
    usual = Protocol.of(given.scene, given.own)
    count = usual.sequences if given.sequences is None else given.sequences
    frames = usual.frames if given.frames is None else given.frames
    for name, value in {"sequences": count, "frames": frames, "factor": given.factor, "jobs": given.jobs}.items():
        if value < 1:
            parser.error(f"--{name} must be at least 1")
    for name, value, most in ("sequences", count, usual.sequences), ("frames", frames, usual.frames):
        if value > most:  # more frames of a dance would be those of the next sequence, the test's even
            parser.error(f"--{name} must be at most {most}, which {given.scene} has")
    plan = Plan.usual(given.scene, frames, factor=given.factor, tracking=given.tracking, own=given.own)
    folder, numbers = given.out or pairs_folder(given.scene, given.own), usual.first(count)
    size = count * (frames + 1) * 9 * plan.world(0).scene.grid.vertices * (1 + given.factor**-2)
    tests = sum(usual.split(number) == SPLITS[1] for number in numbers)
    announce(
        f"{given.scene}, {given.tracking} tracking: {count} sequences of {frames} frames, {tests} of them for testing; "
        f"about {size / 1e6:,.0f} MB in {folder}\nStopped by Ctrl-C, the same command goes on."
    )
    new = generate(plan, folder, numbers, given.jobs, given.ray)
    print(f"{folder}: {new} new of {count} sequences")
    return 0
