"""The backend ``"miniature"``: coarse physics and an upscaler (Lee, Oh & Lee 2019)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from _minicloth_kernels import inspect

from cloth_envs.material import Material
from cloth_envs.naming import unknown_name
from cloth_envs.physics.solver import reference
from cloth_envs.resample import resample
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from surrogates.checkpoint import of_factor
from surrogates.miniature.closure import card, load_factors
from surrogates.miniature.coarse import SCALINGS, coarse_scene, miniature_material
from surrogates.miniature.contact import Projection
from surrogates.miniature.correction import Corrected, Correction, shipped
from surrogates.upscale.local import weights_name
from surrogates.upscale.protocol import make_upscaler

CLOTH = ("positions", "velocities")
CORRECTIONS = ("learned",)
GUARD = 0.5  # strain


def learned(scene: str, factor: int) -> bool:
    """Whether a closure and a local upscaler are shipped for 1/``factor`` of a scene."""
    return scene in card("closure")["scenes"] and bool(of_factor(weights_name("local", scene), factor))


class Upscaled:
    """A field of the cloth that is upscaled when it is first read, and then kept."""

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, state: Any, owner: type | None = None) -> np.ndarray:
        if state is None:
            raise AttributeError(self._name)
        value = state.__dict__[self._name] = state._upscale(state, self._name)
        return value


class UpscaledState(State):
    """A state whose cloth is upscaled when it is first read."""

    positions = Upscaled()
    velocities = Upscaled()

    def __init__(self, coarse: State, upscale: Callable[[State, str], np.ndarray]) -> None:
        self._upscale, self._batch = upscale, coarse.batch
        self.colliders, self.collider_velocities = coarse.colliders, coarse.collider_velocities
        self.wind, self.pressure, self.time = coarse.wind, coarse.pressure, coarse.time

    @property
    def batch(self) -> int:
        return self._batch


class MiniatureBackend:
    """A reference solver on a grid ``factor`` times coarser, upscaled when the cloth is read.

    It is computed enlarged to the cloth's size, where wind sees the upscaled velocity and bodies, handles and
    thickness need no scaling; ``coarse.miniature_material`` says why that is the same. Driven
    vertices of the fine cloth are put exactly where they are driven, others never end in a body: ``contact`` puts
    them on its surface and counts them.

    Args:
        scene: the scene at full resolution.
        num_envs: members of the batch.
        factor: 2, 3 or 4, how many times fewer cells along each side.
        scaling: ``"similar"`` (the sheet's own material), ``"seed"`` (the paper's spring constants, ``factor^2``
            times too stiff), ``"calibrated"`` (factors fitted per scene), ``"closure"`` (those and a law of springs
            in compression, fitted too). With neither this nor an upscaler given, ``"closure"`` and ``"local"`` where
            both are shipped for the scene, else, and if only one is given, ``"similar"`` and ``"bicubic"``.
        factors: of a calibration of your own, ``{material property: multiplier}``, instead of the shipped ones.
        upscaler: an interpolation, ``"bilinear"``, ``"biquadratic"`` or ``"bicubic"``, or a network by name.
        guard: interpolate a cloth bicubically in frames in which the network would strain an edge by over ``GUARD``;
            ``guarded`` tells the last frame's.
        correction: ``"learned"``, a network that corrects the coarse cloth after every frame (``dynamics``).
        solver: of the coarse cloth, as for ``backend="reference"``. threads: over members of the batch.
        solver_kwargs: its other options.

    Raises:
        ValueError: a bad argument, or a scene that has no calibration or correction.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        num_envs: int = 1,
        factor: int = 2,
        scaling: str | None = None,
        factors: Mapping[str, float] | None = None,
        upscaler: str | None = None,
        guard: bool = False,
        correction: str | None = None,
        threads: int = 1,
        solver: str = "explicit",
        solver_kwargs: Mapping[str, Any] | None = None,
    ) -> None:
        if isinstance(factor, bool) or factor not in (2, 3, 4):
            raise ValueError(f"factor must be 2, 3 or 4, got {factor!r}")
        if scaling is None and upscaler is None and solver == "explicit" and learned(scene.name, factor):
            scaling, upscaler = "closure", "local"
        scaling, upscaler = scaling or "similar", upscaler or "bicubic"
        if scaling not in SCALINGS:
            raise unknown_name("scaling", scaling, SCALINGS)
        if not isinstance(guard, bool):
            raise ValueError(f"guard must be True or False, got {guard!r}")
        self.scene, self.factor, self.scaling, self.upscaler = scene, factor, scaling, upscaler
        fitted = scaling in ("calibrated", "closure")
        if factors is not None and not fitted:
            raise ValueError(f'factors need scaling="calibrated" or "closure", got scaling={scaling!r}')
        self._factors = dict(factors or {})
        if fitted and factors is None:
            self._factors = load_factors(scene.name, factor, scaling)
        coarse, self._handles = coarse_scene(scene, factor, self._effective(scene.material))
        options = {"threads": threads, **(solver_kwargs or {})}
        self.coarse = reference(coarse, num_envs=num_envs, solver=solver, **options)
        if correction is not None:
            if correction not in CORRECTIONS:
                raise unknown_name("correction", correction, CORRECTIONS)
            if scaling != "closure":
                raise ValueError(f'correction={correction!r} was trained on scaling="closure", got scaling={scaling!r}')
            self.coarse = Corrected(self.coarse, Correction(coarse, shipped(scene.name, factor)))
        self._up = make_upscaler(upscaler, coarse, scene, factor)
        self._guard, self._bicubic = guard, make_upscaler("bicubic", coarse, scene, factor)
        self._held = np.array(scene.handles, np.int32)
        self.contact, self.guarded = Projection(scene), np.zeros(num_envs, bool)
        self._state: State | None = None

    def _effective(self, material: Material) -> Material:
        return miniature_material(material, self.factor, self.scaling, self._factors)

    @property
    def state(self) -> State:
        if self._state is None:
            raise RuntimeError("there is no cloth yet: call reset(state) first")
        return self._state

    @property
    def memory(self) -> dict[str, np.ndarray]:
        """The coarse cloth, with its past frames: a fine one upscaled from it does not always contain it."""
        cloth = {name: np.stack([getattr(state, name) for state in self._history], 1) for name in CLOTH}
        return {**cloth, "offsets": self._offsets}

    def recall(self, memory: Mapping[str, np.ndarray]) -> None:
        now = self.coarse.state.arrays()
        steps = range(self._up.frames)
        states = [State(**(now | {n: np.ascontiguousarray(memory[n][:, k]) for n in CLOTH})) for k in steps]
        self.coarse.reset(states[-1], self._materials)
        self._history = [*states[:-1], self.coarse.state]
        self._offsets = memory["offsets"].copy()

    def reset(
        self,
        state: State,
        materials: Sequence[Material] | None = None,
        which: Sequence[int] | None = None,
    ) -> None:
        chosen = [self.scene.material] * state.batch if materials is None else list(materials)
        small = {name: self._down(getattr(state, name)) for name in CLOTH}
        effective = [self._effective(material) for material in chosen]
        self.coarse.reset(State(**(state.arrays() | small)), effective, which)
        self._up.set_materials(range(state.batch) if which is None else which, chosen)
        self._start_history(which)
        offsets = self._handles.offsets(state.positions, small["positions"], self.scene.handles)
        if which is None:
            self._state, self._materials, self._offsets = state.astype(np.float32), effective, offsets
        else:
            self._state = self.state.copy()
            self._state.assign(list(which), state)
            self._offsets[list(which)] = offsets
            for i, material in zip(which, effective, strict=True):
                self._materials[i] = material

    def _start_history(self, which: Sequence[int] | None) -> None:
        """The past of cloths that have none: where they came from at their present velocity."""
        members, now = slice(None) if which is None else list(which), self.coarse.state
        if which is None:
            self._history = [now.copy() for _ in range(self._up.frames - 1)]
        for back, past in enumerate(reversed(self._history[: self._up.frames - 1]), 1):
            step = now.velocities[members] * np.float32(back * self.scene.frame_dt)
            past.positions[members] = now.positions[members] - step
            past.velocities[members] = now.velocities[members]
        self._history[self._up.frames - 1 :] = [now]

    def _down(self, field: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(resample(field, self.scene.grid, self.coarse.scene.grid))

    def advance(self, controls: Controls) -> State:
        coarse = self.coarse.advance(self._handles.controls(controls, self._offsets))
        self._history = history = [*self._history[1:], coarse]

        def upscale(state: State, name: str) -> np.ndarray:
            fine = getattr(self._up, name)(history)
            if name == "positions":
                self._handles.place(fine, controls.handle_positions, self._held)
                if self._guard:
                    self._fall_back(fine, history, controls)
                self.contact.positions(fine, state)
            else:
                self._handles.place(fine, controls.handle_velocities, self._held)
                if self.scene.colliders:
                    self.contact.velocities(fine, state.positions, state)
            return fine

        self._state = UpscaledState(coarse, upscale)
        return self._state

    def _fall_back(self, fine: np.ndarray, history: Sequence[State], controls: Controls) -> None:
        """Change strained members of ``fine`` into what interpolation makes of them."""
        grid = self.scene.grid
        found = inspect(fine, fine, grid.row_spacing, grid.col_spacing, grid.periodic)
        self.guarded = np.array([not strain <= GUARD for _, strain, _ in found])
        if self.guarded.any():
            plain = self._bicubic.positions(history)
            self._handles.place(plain, controls.handle_positions, self._held)
            fine[self.guarded] = plain[self.guarded]
