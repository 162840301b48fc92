"""Truth of seeded episodes: the states and controls of a run at one of the named refinements, kept in the cache."""

from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from cloth_envs.grid import coarser
from cloth_envs.physics.truth import TRUTHS
from cloth_envs.registry import load_task
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from cloth_envs.world import World
from training.cache import cached_arrays, digest
from training.rollouts import Recording, record, seeded_actions, stack_controls, stack_states


@dataclass(frozen=True)
class Case:
    """One episode under seeded ``actions`` (a policy's name), on a grid ``coarse`` times coarser (1/2: finer).

    ``truth`` is one of TRUTHS, ``self_contact`` as in ``World``.
    """

    scene: str
    seed: int = 0
    coarse: float = 1
    truth: str = "g1"
    self_contact: bool | None = None
    actions: str = "smooth"

    def world(self) -> World:
        resolution = coarser(load_task(self.scene).resolution, self.coarse)
        options = TRUTHS[self.truth]
        return World(self.scene, backend_kwargs=options, resolution=resolution, self_contact=self.self_contact)

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
