"""The batched engine behind the single and the vector environment."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces

from cloth_envs.failure import Failures
from cloth_envs.grid import check_resolution
from cloth_envs.material import PROPERTIES, Material, as_material, check_ranges
from cloth_envs.naming import unknown_name
from cloth_envs.presets import load_preset, solver_of
from cloth_envs.registry import load_task, make_backend
from cloth_envs.scenes.drives import clip_actions
from cloth_envs.scenes.measures import gather
from cloth_envs.scenes.task import Episode, Start, Task
from cloth_envs.state import Controls, State

OBSERVATIONS = ("keypoints", "mesh")
POSITION_BOUND = 20.0  # m; observations are clipped to it
VELOCITY_BOUND = 100.0  # m/s


class World:
    """``num_envs`` episodes of one scene on one backend.

    ``scene`` is a name, or a task's class, which is taken as it is: of ``preset`` only the solver counts then.

    Attributes:
        controls: what the last ``step`` gave to the backend; None before the first.
        title: scene, resolution and backend in a few words.

    Raises:
        ValueError: unknown scene, preset, backend, fabric, property or observation (the nearest match is
            named), or a resolution, material or range that makes no sense or that the preset fixes.
    """

    def __init__(
        self,
        scene: str | type[Task],
        *,
        num_envs: int = 1,
        backend: str = "reference",
        backend_kwargs: Mapping[str, Any] | None = None,
        obs: str = "keypoints",
        material: str | Mapping[str, float] | Material | None = None,
        randomize: Mapping[str, Sequence[float]] | None = None,
        resolution: Sequence[int] | None = None,
        preset: str | Mapping[str, Any] | None = None,
    ) -> None:
        if obs not in OBSERVATIONS:
            raise unknown_name("observation", obs, OBSERVATIONS)
        if not isinstance(scene, str):
            task_class = scene
        else:
            task_class = load_task(scene) if preset is None else load_preset(scene, preset)
        for name, value in {"material": material, "randomize": randomize, "resolution": resolution}.items():
            if value and name in task_class.fixed:
                raise ValueError(f"preset={preset!r} fixes the {name}: leave {name}= out")
        base = as_material(material, task_class.material)
        self.ranges = check_ranges(randomize)
        shape = check_resolution(resolution, task_class.resolution)
        self.task: Task = task_class(task_class.make_scene(resolution=shape, material=base))
        self.scene = self.task.scene
        if backend == "reference" and "solver" not in (backend_kwargs or {}):
            backend_kwargs = {**solver_of(preset), **(backend_kwargs or {})}
        self.backend = make_backend(backend, self.scene, num_envs=num_envs, backend_kwargs=backend_kwargs)
        self.num_envs, self.obs = num_envs, obs
        self.title = f"{self.scene.name} {self.scene.grid} {backend}"
        self.failures = Failures(self.scene, self.task.max_strain)
        self.rngs: list[np.random.Generator | None] = [None] * num_envs
        self.materials = [base] * num_envs
        self.frames = np.zeros(num_envs, np.int64)
        self._episode: Episode | None = None
        self.controls: Controls | None = None

        n, k = len(self.task.keypoints), len(self.task.extras)
        bounds = [POSITION_BOUND, VELOCITY_BOUND, self.task.extras_bound]
        bound = np.repeat(np.array(bounds, np.float32), [3 * n, 3 * n, k])
        self._bound = bound
        self.action_space = spaces.Box(-1.0, 1.0, (len(self.task.actions),), np.float32)
        self.observation_space: spaces.Space[Any]
        if obs == "keypoints":
            self.observation_space = spaces.Box(-bound, bound, dtype=np.float32)
        else:
            limit = np.repeat(np.array(bounds[:2], np.float32), 3)
            mesh = np.broadcast_to(limit[:, None, None], (6, *self.scene.grid.shape))
            limits = {"mesh": mesh, "task": bound[-k:]}
            self.observation_space = spaces.Dict({n: spaces.Box(-b, b, dtype=np.float32) for n, b in limits.items()})

    def __repr__(self) -> str:
        return f"<World {self.title}, {self.num_envs} environments, {self.progress}>"

    @property
    def started(self) -> bool:
        """Whether there is a cloth."""
        return self._episode is not None

    @property
    def progress(self) -> str:
        """The frames since the reset, as text."""
        if not self.started:
            return "before reset()"
        low, high = self.frames.min(), self.frames.max()
        return f"frame {low}" if low == high else f"frames {low} to {high}"

    @property
    def episode(self) -> Episode:
        if self._episode is None:
            raise RuntimeError("there is no cloth yet: call reset() first")
        return self._episode

    @property
    def state(self) -> State:
        return self.episode.state

    def reset(self, rngs: Mapping[int, np.random.Generator]) -> None:
        """Start new episodes for the environments named by the keys, each drawing from its own generator."""
        which = sorted(rngs)
        starts: list[Start] = []
        for i in which:
            rng = self.rngs[i] = rngs[i]
            changes = {name: float(rng.uniform(lo, hi)) for name, (lo, hi) in self.ranges.items()}
            self.materials[i] = self.scene.material.with_changes(**changes)
            starts.append(self.task.start(rng))
        state = State.still(
            np.stack([s.positions for s in starts]).astype(np.float32),
            np.stack([s.colliders for s in starts]).astype(np.float32),
        )
        state.velocities[:] = [s.velocities for s in starts]
        memory = {name: np.stack([s.memory[name] for s in starts]) for name in starts[0].memory}
        self._place(which, state, memory)
        self.frames[which] = 0

    def _place(self, which: Sequence[int], state: State, memory: dict[str, np.ndarray]) -> None:
        materials = [self.materials[i] for i in which]
        if self._episode is None:
            if len(which) < self.num_envs:
                raise RuntimeError("the first reset must start every environment")
            self.backend.reset(state, materials)
            self._episode = Episode(self.backend.state, memory, np.zeros((self.num_envs, len(self.task.actions))))
            return
        self.backend.reset(state, materials, which)
        self.episode.state = self.backend.state
        for name, values in memory.items():
            self.episode.memory[name][which] = values

    def set_positions(self, positions: np.ndarray, velocities: np.ndarray | None = None, which: int = 0) -> None:
        """See ``ClothEnv.set_positions``; ``which`` is the member."""
        state = self.state.select([which])
        parts = {"positions": positions, "velocities": np.zeros_like(positions) if velocities is None else velocities}
        for name, value in parts.items():
            target, given = getattr(state, name)[0], np.asarray(value)
            if given.shape != target.shape or not np.isfinite(given).all():
                raise ValueError(f"{name} must be finite and of shape {target.shape}, got {given.shape}")
            target[:] = given
        self._place([which], state, {})

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, list[str | None]]:
        """One frame. Returns rewards ``(B,)`` in [0, 1] and, per environment, why it failed or None.

        A failed environment is put back to its last good state.

        Raises:
            ValueError: actions of the wrong shape or not finite; nothing has moved then.
        """
        episode, before = self.episode, self.state
        actions = np.asarray(actions, np.float64)
        expected = (self.num_envs, len(self.task.actions))
        if actions.shape != expected:
            raise ValueError(
                f"action has shape {actions.shape[1:]}, expected {expected[1:]}: {', '.join(self.task.actions)}"
            )
        clipped = clip_actions(actions)
        if clipped is None:
            raise ValueError("action holds NaN or infinity; the state is unchanged, pass numbers in [-1, 1]")
        episode.action = clipped
        self.controls = self.task.controls(episode)
        episode.state = self.backend.advance(self.controls)
        self.frames += 1
        reasons = self.failures.check(before, episode.state)
        failed = [i for i, reason in enumerate(reasons) if reason]
        if failed:
            good = before.select(failed)
            good.time[:] = episode.state.time[failed]
            self.backend.reset(good, [self.materials[i] for i in failed], failed)
            episode.state = self.backend.state
        rewards = self.task.reward(episode)
        if failed:
            rewards[failed] = 0.0
        return rewards, reasons

    def observe(self) -> Any:
        """Observations of the batch, freshly allocated, in ``observation_space`` with a leading axis."""
        state, episode = self.state, self.episode
        extras = self.task.observe(episode)
        if self.obs == "mesh":
            mesh = np.concatenate([state.positions, state.velocities], 1)
            space = self.observation_space["mesh"]  # type: ignore[index]
            np.clip(mesh, space.low, space.high, out=mesh)
            limit = self.task.extras_bound
            return {"mesh": mesh, "task": np.clip(extras, -limit, limit).astype(np.float32)}
        out = np.empty((self.num_envs, len(self._bound)), np.float32)
        out[:, -extras.shape[1] :] = extras
        gather(state.positions, state.velocities, self.task.keypoints, self._bound, out)
        return out

    def get_state(self) -> dict[str, np.ndarray]:
        """See ``ClothEnv.get_state``."""
        state, episode = self.state, self.episode
        saved = {f"state.{name}": value.copy() for name, value in state.arrays().items()}
        saved |= {f"memory.{name}": value.copy() for name, value in episode.memory.items()}
        saved |= {f"backend.{name}": value.copy() for name, value in self.backend.memory.items()}
        saved["frames"] = self.frames.copy()
        saved["materials"] = np.array([[getattr(m, p) for p in PROPERTIES] for m in self.materials])
        saved["rng"] = np.array([json.dumps(rng.bit_generator.state if rng else None) for rng in self.rngs])
        return saved

    def set_state(self, saved: Mapping[str, np.ndarray]) -> None:
        """Continue from what ``get_state`` gave, bit for bit on the same backend.

        Another backend continues from the same positions, velocities, bodies, goals and generators; what
        the saved one remembered beyond them is left out then.

        Raises:
            ValueError: the state belongs to another scene, resolution or number of environments.
        """
        parts = {name: np.asarray(value) for name, value in saved.items()}
        shape = (self.num_envs, 3, *self.scene.grid.shape)
        found = parts["state.positions"].shape if "state.positions" in parts else None
        if found != shape or parts["state.colliders"].shape[1] != len(self.scene.colliders):
            raise ValueError(
                f"this state has positions of shape {found}, the environment {shape}: "
                "set it in an environment of the same scene, resolution and num_envs"
            )
        self.materials = [Material(**dict(zip(PROPERTIES, row, strict=True))) for row in parts["materials"].tolist()]
        self.frames = parts["frames"].copy()
        for i, text in enumerate(parts["rng"].tolist()):
            content = json.loads(text)
            if content is not None:
                generator = np.random.Generator(getattr(np.random, content["bit_generator"])())
                generator.bit_generator.state = content
                self.rngs[i] = generator
        state = State(**{n.split(".")[1]: a for n, a in parts.items() if n.startswith("state.")})
        memory = {n.split(".")[1]: a.copy() for n, a in parts.items() if n.startswith("memory.")}
        self._place(list(range(self.num_envs)), state, memory)
        own = {name: parts.get(f"backend.{name}") for name in self.backend.memory}
        if all(a is not None and a.shape == self.backend.memory[name].shape for name, a in own.items()):
            self.backend.recall({name: a for name, a in own.items() if a is not None})


def member(observations: Any, i: int) -> Any:
    """What one environment of the batch observes."""
    return {name: part[i] for name, part in observations.items()} if isinstance(observations, dict) else observations[i]
