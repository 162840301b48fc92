"""The default reference solver: symplectic Euler at the largest stable step, compiled."""

from collections.abc import Sequence
from functools import lru_cache

import _minicloth_kernels as kernels
import numpy as np

from cloth_envs.arguments import whole_number
from cloth_envs.material import Material
from cloth_envs.physics.laws.diagnostics import strains
from cloth_envs.physics.solver import (
    PRESSURE,
    STRETCH,
    Solver,
    air_bound,
    kernel_material,
    kernel_sheet,
    pressure_bound,
    stiffness_bound,
)
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State

MAX_SUBSTEPS = 20_000  # per frame
SAFETY = 0.9


@lru_cache(maxsize=1024)  # an environment asks before it sets a material
def stable_step(scene: Scene, material: Material, pressure: float = PRESSURE) -> float:
    """The step ``h`` [s] for which ``h^2 K + 2 h C <= 4 M`` with safety 0.9.

    Symplectic Euler with the damping force taken at the old velocity has, for each mode, the
    characteristic polynomial ``z^2 - (2 - h c - h^2 k) z + (1 - h c)``; its roots stay in the unit
    circle while ``h^2 k + 2 h c <= 4``. ``c`` holds the dashpots (``damping`` times the springs'
    stiffness) and the slope of the air's force (``air_bound``). Every spring adds the larger of what
    it adds lengthened and shortened, so the step is the smaller one of a sheet of either. Where the scene has pressure
    ``k`` holds that of ``pressure`` [Pa].
    """
    springs, bending = stiffness_bound(scene, material)
    other, air = bending + pressure_bound(scene, material, pressure), air_bound(scene, material, pressure)

    def step(stiffness: float, damping: float) -> float:
        k, c = stiffness * springs + other, damping * material.damping * springs + air
        return 2 / (np.sqrt(c * c / 4 + k) + c / 2)

    return SAFETY * min(step(1, 1), step(material.compression, material.compression_damping))


class ExplicitSolver(Solver):
    """Symplectic Euler, ``v += h a(x, v)`` then ``x += h v``, in equal substeps of a frame.

    The number of substeps comes from a bound on the spectrum (``stable_step``), so every
    material that is not refused is stable; a frame in a pressure of over 100 Pa is stepped in as many more as that
    needs. Handles and bodies move on cubics through the frame.

    Args, beside those of ``Solver``:
        substeps: per frame, instead of the largest stable step; not below the stable number.
        refine: multiplies the number of substeps (4 for truth).

    Raises:
        ValueError: a bad argument, or a material so stiff or light (in ``advance``: a pressure so large) that a frame
            would need more than 20,000 substeps, or more than ``substeps``; a cloth burst by more than 100 Pa.
    """

    yields = True

    def __init__(
        self,
        scene: Scene,
        *,
        num_envs: int = 1,
        threads: int = 1,
        dtype: str = "float32",
        substeps: int | None = None,
        refine: int = 1,
    ) -> None:
        super().__init__(scene, num_envs=num_envs, threads=threads, dtype=dtype)
        self._refine = whole_number("refine", refine)
        self._wanted = None if substeps is None else whole_number("substeps", substeps)
        kernel = kernels.Explicit32 if self.dtype == np.float32 else kernels.Explicit64
        self._kernel = kernel(kernel_sheet(scene))
        self._stepped = [scene.material] * num_envs
        self._felt = [kernel_material(scene.material)] * num_envs
        self.substeps = np.ones(num_envs, np.int32)
        self.set_materials(range(num_envs), [scene.material] * num_envs)

    def check_material(self, material: Material) -> None:
        super().check_material(material)
        self._count(material)

    def set_materials(self, which: Sequence[int], materials: Sequence[Material]) -> None:
        for i, m in zip(which, materials, strict=True):
            self._stepped[i], self._felt[i], self.substeps[i] = m, kernel_material(m), self._count(m)

    def _count(self, material: Material, pressure: float = PRESSURE, cause: str = "this material") -> int:
        """Substeps in a frame. Raises ValueError: more than the limit, or fewer wanted than are stable."""
        least = np.ceil(self.scene.frame_dt / stable_step(self.scene, material, pressure))
        count = least * self._refine if self._wanted is None else self._wanted
        if count < least:
            what = cause.removeprefix("this ")
            raise ValueError(f"substeps={count} is unstable for this grid and {what}; use at least {least:.0f}")
        if not count <= MAX_SUBSTEPS:
            raise ValueError(
                f"{cause} needs {count:.0f} substeps a frame, the limit is {MAX_SUBSTEPS}: lower its stiffness "
                "or damping, raise its areal_density, or use a coarser resolution"
            )
        return int(count)

    def _counts(self, positions: np.ndarray, pressure: np.ndarray) -> np.ndarray:
        """Substeps ``(B,)`` of a frame from ``positions`` in a ``pressure`` ``(B,)`` [Pa].

        What pressure does grows with the edges' lengths: they may double in a frame.
        """
        high = abs(pressure) > PRESSURE if self.scene.pressure else np.False_
        if not high.any():
            return self.substeps
        counts = self.substeps.copy()
        for i in np.flatnonzero(high):
            with np.errstate(all="ignore"):
                stretch = 1 + strains(self.scene.grid, positions[[i]]).max()
                load = abs(pressure[i]) * max(2 * stretch / STRETCH, 1.0)
                load = 2 ** (np.ceil(4 * np.log2(load)) / 4)  # few different ones
            cause = f"a pressure of {pressure[i]:g} Pa on cloth that it stretched {stretch:.3g} times"
            counts[i] = self._count(self._stepped[i], float(load), cause)
        return counts

    def step(self, old: State, new: State, controls: Controls) -> None:
        counts = self._counts(old.positions, controls.pressure)
        self._kernel.advance(old, new, controls, self._felt, counts, self.threads)
        if counts is not self.substeps and not np.isfinite(new.positions).all():
            raise ValueError(
                f"a pressure of {abs(controls.pressure).max():g} Pa burst the cloth: lower it, raise the cloth's "
                "stretch_stiffness, or give a larger refine"
            )
