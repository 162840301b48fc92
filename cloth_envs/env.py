"""The single Gymnasium environment."""

from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np

from cloth_envs import folds
from cloth_envs.arguments import check_reset_options, check_seed, one_of, read_actions, true_or_false
from cloth_envs.backend import plain_words
from cloth_envs.members import OneCloth
from cloth_envs.observation import member
from cloth_envs.options import check_options
from cloth_envs.state import State
from cloth_envs.time_limit import TimeLimits
from cloth_envs.world import World

if TYPE_CHECKING:
    from cloth_envs.rendering import Renderer


class ClothEnv(OneCloth, gym.Env[Any, np.ndarray]):
    """A cloth scene; made by ``gym.make("MiniCloth-<Scene>-v0", ...)``, or ``-v1``.

    What there is to do is told by ``env.unwrapped.task.__doc__``, and by ``minicloth list --scene <Scene>``.

    Arguments:
        scene: the scene's name, with ``-v1`` its task of that version.
        backend: which physics, by name or as ``module:attribute``: spaces, seeds and task are the same for all.
        backend_kwargs: passed to the backend; ``"reference"`` takes a ``solver`` and that solver's own options
            (see ``cloth_envs.physics.solver.SOLVERS``).
        physics, physics_kwargs: other words for these two, where a library keeps ``backend`` to itself, as TorchRL's
            ``GymEnv`` does.
        obs: ``"keypoints"``, a flat Box, or ``"mesh"``, a Dict of the geometry image ``mesh`` ``(6, H, W)``
            (positions, velocities) and the numbers of the ``task``.
        material: a fabric's name or a dict of ``Material`` properties.
        randomize: ``{property: (low, high)}``, drawn uniformly at every reset, and told by ``info["material"]``.
        observe_material: whether observations hold these properties too, before the numbers of the ``task``: where in
            its range each is, from -1 to 1. In ``"mesh"`` ones they are ``material``.
        resolution: ``(rows, cols)`` of the grid, at equal size and material.
        preset: a paper's set-up, by name or ``{"name": ..., option: number}`` (see ``minicloth list``); zero actions
            are then the paper's scene. ``"lee2019"`` steps by P-ADMM, as its paper did, where ``backend_kwargs`` names
            no ``solver``. ``"zhao2024"`` and ``"zhao2024-fall"`` fix material and resolution.
        self_contact: whether the cloth's folds keep out of each other; by default as the scene lists it, where the
            physics can. ``scene.describe()`` says what is modelled.
        render_mode: ``"rgb_array"`` (uint8 ``(480, 640, 3)``) or ``"depth_array"`` (float32 [m]).
        show_goal: whether pictures show what the task wants: violet, and green in frames of success; in ink, what the
            cloth does. Depth does not.

    Raises:
        ValueError: a bad argument; says what to write instead.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array", "depth_array"], "render_fps": 25}  # noqa: RUF012

    def __init__(self, scene: str, *, render_mode: str | None = None, show_goal: bool = True, **options: Any) -> None:
        options = plain_words(options)
        check_options(options, scene, World, type(self))
        if render_mode is not None:
            one_of("render_mode", render_mode, self.metadata["render_modes"])
        self.show_goal = true_or_false("show_goal", show_goal)
        self.world = World(scene, **options)
        if options.get("resolution") is not None:
            folds.warn_coarse(self.world.scene)
        self.render_mode = render_mode
        self.metadata = {**type(self).metadata, "render_fps": round(1 / self.scene.frame_dt)}
        self.observation_space = self.world.observer.space
        self.action_space = self.world.action_space
        self._renderer: Renderer | None = None
        self._start: State | None = None  # of the episode, which its pictures are framed by
        self._limits = TimeLimits()

    def __repr__(self) -> str:  # str() names the id, as Gymnasium's wrappers expect
        return f"<ClothEnv {self.world.title}, {self.world.progress}>"

    def _repr_html_(self) -> str:
        from cloth_envs.rendering.notebook import card

        return card(repr(self), self.scene, self.state if self.world.started else None)

    def set_positions(self, positions: np.ndarray, velocities: np.ndarray | None = None) -> None:
        """Place the cloth: ``(3, H, W)`` [m] and [m/s] (default at rest). Goals, bodies and time stay.

        It should be outside of bodies, or a centimetre inside at most: what is deeper is flung out.

        Raises:
            ValueError: wrong shape or values that are not finite; the state is unchanged.
        """
        self.world.set_positions(positions, velocities)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        self._limits.find(self)
        try:
            check_reset_options(options)
            seed = check_seed(seed)
        except ValueError:
            self._limits.move(0, int(self.world.frames[0]))  # they have begun to count anew
            raise
        super().reset(seed=seed)
        self.world.reset({0: self.np_random})
        self._start = None if self.render_mode is None else self.state.copy()
        why = self.world.surrogate[0]
        return self._observation(), ({"surrogate": why} if why else {}) | self._material()

    def _material(self) -> dict[str, Any]:
        """``info["material"]``, where it is randomised."""
        world = self.world
        return {"material": dict(zip(world.ranges, world.varied[0].tolist(), strict=True))} if world.ranges else {}

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        chosen = read_actions(action, self.world.action_space.shape, self.world.task.actions)
        rewards, reasons = self.world.advance(chosen[None])
        observation = self._observation()
        info = self.world.told_of_one
        if self.world.ranges:
            info |= self._material()
        if reasons:
            info["failure"] = reasons[0]
        if reasons or self._limits.reached():
            info["final_second"] = self.world.final_second().item()
        if self.world.guarded[0]:
            info["guard"] = True
        if crossings := int(self.world.crossings[0]):
            info["crossings_at_start"] = crossings
        if not np.isnan(error := self.world.measured_error[0]):
            info["measured_error"] = float(error)
        return observation, float(rewards[0]), bool(reasons), False, info

    def _observation(self) -> Any:
        return member(self.world.observe(), 0)

    def get_state(self) -> dict[str, np.ndarray]:
        """Everything that decides the future, as arrays: save with ``numpy.savez(file, **state)``."""
        return self.world.get_state()

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Continue from what ``get_state`` gave, here or in another process, bit for bit, time limit included.

        Raises:
            ValueError: something is missing or not finite, or the state belongs to another scene, preset, resolution
                or self_contact; nothing has changed.
        """
        before = int(self.world.frames[0])
        self.world.set_state(state)
        self._limits.move(before, int(self.world.frames[0]))
        if self._start is None and self.render_mode is not None:
            self._start = self.state.copy()
        generator = self.world.rngs[0]
        if generator is not None:
            self.np_random = generator

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_renderer": None}  # a copy draws with its own

    def render(self) -> np.ndarray | None:
        if self.render_mode is None:
            gym.logger.warn("render() was called without a render_mode; pass render_mode='rgb_array' to gym.make")
            return None
        if self._renderer is None:
            from cloth_envs.rendering import Renderer

            self._renderer = Renderer(self.scene)
        if self.render_mode == "depth_array":
            return self._renderer.depth(self.state, start=self._start)
        marks, met = self.world.goal(0) if self.show_goal else ((), False)
        return self._renderer.draw(self.state, start=self._start, marks=marks, met=met)

    def close(self) -> None:
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
