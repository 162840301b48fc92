"""Coarse physics: a scene on a coarser grid, stepped by a reference solver under the controls of the fine cloth."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from _minicloth_kernels import Correct

from cloth_envs.arguments import as_number, one_of
from cloth_envs.grid import Grid
from cloth_envs.material import PROPERTIES, Material
from cloth_envs.physics.explicit.bounds import HELD
from cloth_envs.physics.solver import reference
from cloth_envs.resample import on_grid
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from surrogates.miniature.card import Card
from surrogates.miniature.closure import SCALINGS, load_factors, miniature_material
from surrogates.miniature.correction import Correction
from surrogates.miniature.handles import Handles

CLOTH = ("positions", "velocities")


def coarse_grid(grid: Grid, factor: float, least: int = 2) -> Grid:
    """The same sheet with about ``factor`` times fewer cells along each side.

    Where ``factor`` divides the cells, every vertex of it is a vertex of ``grid``. Along each side ``least`` cells are
    kept, or all where there are fewer.
    """
    rows, cols = (max(min(cells, least), round(cells / factor)) for cells in grid.cells)
    return replace(grid, rows=rows + 1, cols=max(3, cols if grid.periodic else cols + 1))


def coarse_scene(scene: Scene, factor: float, material: Material, least: int = 2) -> tuple[Scene, Handles]:
    """``scene`` on ``coarse_grid`` with ``material``, and how its handles follow those of ``scene``.

    Where the cloth keeps out of itself, its layers are thicker as its cells are larger.
    """
    grid = coarse_grid(scene.grid, factor, least)
    handles = Handles.of(scene.grid, grid, scene.handles, scene.grips)
    own = scene.self_contact
    if own is not None:
        own = replace(own, thickness=scene.layer * grid.row_spacing / scene.grid.row_spacing)
    return replace(scene, grid=grid, handles=handles.vertices, material=material, self_contact=own), handles


def _numbers(factors: Mapping[str, float]) -> dict[str, float]:
    """Multipliers of a calibration by property. Raises ValueError: another property, or no number of at least 0."""
    read = {}
    for name, value in factors.items():
        number = as_number(value)
        if number is None or not 0 <= number < np.inf:
            raise ValueError(f"factors[{name!r}] must be a number of at least 0, got {value!r}")
        read[one_of("material property in factors:", name, PROPERTIES)] = number
    return read


class CoarsePhysics:
    """A reference solver on a grid ``factor`` times coarser, driven as the fine cloth is.

    It is computed enlarged to the cloth's size, where wind sees the upscaled velocity and bodies, handles and
    thickness need no scaling; ``closure.miniature_material`` says why that is the same.

    Args:
        fine: the scene at full resolution. num_envs: members of the batch.
        factor, least: how many times fewer cells along each side, above 1, and how many are kept: ``coarse_grid``.
        scaling, factors: of the sheet's material, see ``closure``.
        card: where the factors hold; cloths of a material beyond it keep their own.
        solver, options: of the coarse cloth, as for ``backend="reference"``.

    Attributes:
        scene: on the coarse grid.
        handles: how its driven vertices follow those of ``fine``.
        frames: how many states ``history`` holds; set it before ``reset``.
        history: the last coarse states, the newest last. They are never changed afterwards.

    Raises:
        ValueError: a bad argument, or a scene that has no calibration.
    """

    def __init__(
        self,
        fine: Scene,
        *,
        num_envs: int = 1,
        factor: float = 2,
        least: int = 2,
        scaling: str = "similar",
        factors: Mapping[str, float] | None = None,
        card: Card | None = None,
        solver: str = "explicit",
        options: Mapping[str, Any] | None = None,
    ) -> None:
        self.fine, self.factor, self.scaling = fine, factor, scaling
        one_of("scaling", scaling, SCALINGS)
        if scaling in ("similar", "seed"):
            if factors is not None:
                raise ValueError(
                    f'factors need scaling="calibrated" or another that is fitted, got scaling={scaling!r}'
                )
            factors = {}
        self._factors = load_factors(fine.name, factor, scaling) if factors is None else _numbers(factors)
        self._card = card
        self.scene, self.handles = coarse_scene(fine, factor, self.material(fine.material), least)
        # A coarse grid's own errors are larger than the air's; one that is not coarser is stepped as the reference.
        coarser = self.scene.grid != fine.grid and fine.particles is None
        usual = {"held": HELD} if solver == "explicit" and coarser else {}
        self.solver = reference(self.scene, num_envs=num_envs, solver=solver, **usual | dict(options or {}))
        self.frames = 1
        self.history: list[State] = []
        self._correct: Correct | None = None

    def material(self, fine: Material) -> Material:
        """What a cloth of material ``fine`` is made of on the coarse grid."""
        beyond = self._card is not None and self._card.material_beyond(fine)
        return miniature_material(fine, self.factor, self.scaling, {} if beyond else self._factors)

    def check_material(self, fine: Material) -> None:
        """Refuse a fine material whose coarse one the solver can't step. Raises ValueError: says what to change."""
        check = getattr(self.solver, "check_material", None)
        if check is not None:
            check(self.material(fine))

    def correct(self, correction: Correction) -> None:
        """Let a network change every frame from now on.

        Raises:
            ValueError: a solver in float64.
        """
        if getattr(self.solver, "dtype", np.float32) != np.float32:
            raise ValueError('correction="learned" needs a solver in float32: leave dtype out')
        self._correct = correction.compiled()

    @property
    def state(self) -> State:
        """The present coarse state."""
        return self.solver.state

    def reset(
        self, state: State, materials: Sequence[Material] | None = None, which: Sequence[int] | None = None
    ) -> None:
        """Begin at fine cloths of fine materials; see ``Backend.reset``."""
        chosen = [self.fine.material] * state.batch if materials is None else materials
        driven = state.positions.reshape(state.batch, 3, -1)[:, :, list(self.fine.handles)].transpose(0, 2, 1)
        self.start(on_grid(state, self.fine.grid, self.scene.grid), driven, [self.material(m) for m in chosen], which)

    def start(
        self,
        state: State,
        driven: np.ndarray,
        materials: Sequence[Material] | None = None,
        which: Sequence[int] | None = None,
    ) -> None:
        """Begin at coarse cloths of coarse materials, while the fine handles are at ``driven`` ``(B, N, 3)`` [m]."""
        chosen = [self.scene.material] * state.batch if materials is None else list(materials)
        self.solver.reset(state, chosen, which)
        offsets = self.handles.offsets(state.positions, driven)
        if which is None:
            self._materials, self._offsets = chosen, offsets
        else:
            self._offsets[list(which)] = offsets
            for i, material in zip(which, chosen, strict=True):
                self._materials[i] = material
        # The past of cloths that have none is where they came from at their present velocity.
        members, now, past = slice(None) if which is None else list(which), self.state, []
        x, v = now.positions[members], now.velocities[members]
        for back in range(self.frames - 1, 0, -1):
            then = (now if which is None else self.history[-1 - back]).copy()
            then.positions[members], then.velocities[members] = x - v * np.float32(back * self.scene.frame_dt), v
            past.append(then)
        self.history = [*past, now]

    def advance(self, controls: Controls) -> State:
        """One frame under the fine cloth's controls; returns the coarse state."""
        after = self.solver.advance(self.handles.controls(controls, self._offsets))
        if self._correct is not None:
            before = self.history[-1]
            self._correct.apply(before.velocities, after.wind, after.colliders, after.positions, after.velocities)
        self.history = [*self.history[1:], after]
        return after

    @property
    def memory(self) -> dict[str, np.ndarray]:
        """The history's cloths and how handles are followed: a fine state does not always contain them."""
        cloth = {name: np.stack([getattr(state, name) for state in self.history], 1) for name in CLOTH}
        return {**cloth, "offsets": self._offsets}

    def recall(self, memory: Mapping[str, np.ndarray]) -> None:
        """Take back, after a ``reset`` of the whole batch, what ``memory`` held."""
        now = self.state.arrays()
        cloths = [{n: np.ascontiguousarray(memory[n][:, k]) for n in CLOTH} for k in range(self.frames)]
        states = [State(**(now | cloth)) for cloth in cloths]
        self.solver.reset(states[-1], self._materials)
        self.history = [*states[:-1], self.state]
        self._offsets = memory["offsets"].copy()
