"""Truth of seeded episodes: the states and controls of a run at one of the named refinements, kept in the cache."""

from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from cloth_envs.grid import coarser
from cloth_envs.physics.truth import TRUTHS
from cloth_envs.presets import load_preset
from cloth_envs.registry import PRESETS, load_task
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from cloth_envs.world import World
from training.cache import cached_arrays, digest
from training.rollouts import Recording, record, seeded_actions, stack_controls, stack_states

DETAILED = tuple(PRESETS["chen2020"])  # scenes with super-resolution, measured on the grids that it was trained on


def unseen(scene: str) -> int | None:
    """The last sequence of a scene of Chen et al. 2020, which no network was trained on; None of other scenes."""
    return load_preset(scene, "chen2020").sequences - 1 if scene in DETAILED else None  # type: ignore[attr-defined]


@dataclass(frozen=True)
class Case:
    """One episode under seeded ``actions`` (a policy's name), on a grid ``coarse`` times coarser (1/2: finer).

    ``truth`` is one of TRUTHS, ``self_contact`` as in ``World``; ``sequence`` is that of ``preset="chen2020"``, without
    which the scene is its own.
    """

    scene: str
    seed: int = 0
    coarse: float = 1
    truth: str = "g1"
    self_contact: bool | None = None
    actions: str = "smooth"
    sequence: int | None = None

    @property
    def place(self) -> dict[str, Any]:
        """``preset`` and ``resolution`` of its world."""
        preset = None if self.sequence is None else {"name": "chen2020", "sequence": self.sequence}
        task = load_task(self.scene) if preset is None else load_preset(self.scene, preset)
        return {"preset": preset, "resolution": coarser(task.resolution, self.coarse)}

    def world(self) -> World:
        return World(self.scene, backend_kwargs=TRUTHS[self.truth], self_contact=self.self_contact, **self.place)

    def record(self, frames: int, keep: Iterable[int]) -> Recording:
        """The run, computed.

        Raises:
            ValueError: the truth itself failed.
        """
        world = self.world()
        run = record(world, seeded_actions(world, [self.seed], [self.actions], frames), keep, seeds=[self.seed])
        if run.failures[0]:
            raise ValueError(f"the truth of {self} failed ({run.failures[0]}): choose another seed")
        return run


@dataclass(frozen=True)
class Truth:
    """``states`` by frame number, the ``controls`` of every frame, and a ``key`` that tells its content."""

    scene: Scene
    states: dict[int, State]
    controls: list[Controls]
    key: str


def load(case: Case, frames: int, keep: Iterable[int], folder: Path) -> Truth:
    """The truth of ``case``, from ``folder`` if it is there, else computed and stored there.

    Its name is a hash of the case, the scene and the first frame, which is computed anew, so that a changed kernel,
    task or material is never answered by an old truth.
    """
    wanted = sorted(set(keep))
    first = case.record(1, [0, 1])
    arrays = [a for item in (*first.states.values(), *first.controls) for a in vars(item).values()]
    key = digest(case, first.scene, frames, wanted, *arrays)

    def make() -> dict[str, np.ndarray]:
        run = case.record(frames, wanted)
        parts = {"state": stack_states([run.states[f] for f in wanted]), "controls": stack_controls(run.controls)}
        return {f"{part}.{name}": array for part, batch in parts.items() for name, array in vars(batch).items()}

    kept = cached_arrays(folder / f"{case.scene.lower()}_{key}.npz", make)

    def part(kind: type[State] | type[Controls], name: str, i: int) -> Any:
        return kind(**{field.name: kept[f"{name}.{field.name}"][[i]] for field in fields(kind)})

    states = {frame: part(State, "state", i) for i, frame in enumerate(wanted)}
    return Truth(first.scene, states, [part(Controls, "controls", i) for i in range(frames)], key)
