"""The default reference solver: symplectic Euler at the largest stable step, compiled."""

from __future__ import annotations

from collections.abc import Sequence

import _minicloth_kernels as kernels
import numpy as np

from cloth_envs.material import Material
from cloth_envs.physics.explicit.stability import stable_step
from cloth_envs.physics.solver import Solver, kernel_material, kernel_sheet, whole_number
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State

MAX_SUBSTEPS = 20_000  # per frame
_KERNELS: dict[str, type[kernels.Explicit32] | type[kernels.Explicit64]] = {
    "float32": kernels.Explicit32,
    "float64": kernels.Explicit64,
}


class ExplicitSolver(Solver):
    """Symplectic Euler, ``v += h a(x, v)`` then ``x += h v``, in equal substeps of a frame.

    The number of substeps comes from a bound on the spectrum (``stability.stable_step``), so every
    material that is not refused is stable. Handles and bodies move on cubics through the frame.

    Args:
        scene: what is modelled; terms that it does not list are not evaluated.
        num_envs: members of the batch.
        threads: over members of the batch; results do not depend on it.
        dtype: ``"float32"``, or ``"float64"`` for truth.
        substeps: per frame, instead of the largest stable step; not below the stable number.
        refine: multiplies the number of substeps (4 for truth).

    Raises:
        ValueError: a bad argument, or a material so stiff or light that a frame would need more
            than 20,000 substeps.
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
        self._refine, self._wanted = whole_number("refine", refine), substeps
        self._kernel = _KERNELS[dtype](kernel_sheet(scene))
        self._felt = [kernel_material(scene, scene.material)] * num_envs
        self.substeps = np.ones(num_envs, np.int32)
        self.set_materials(range(num_envs), [scene.material] * num_envs)

    def set_materials(self, which: Sequence[int], materials: Sequence[Material]) -> None:
        for i, m in zip(which, materials, strict=True):
            self._felt[i] = kernel_material(self.scene, m)
            self.substeps[i] = self._count(m)

    def _count(self, material: Material) -> int:
        least = int(np.ceil(self.scene.frame_dt / stable_step(self.scene, material)))
        count = least * self._refine if self._wanted is None else self._wanted
        if count < least:
            raise ValueError(f"substeps={count} is unstable for this grid and material; use at least {least}")
        if count > MAX_SUBSTEPS:
            raise ValueError(
                f"this material needs {count} substeps a frame, the limit is {MAX_SUBSTEPS}: lower its stiffness or "
                "damping, raise its areal_density, or use a coarser resolution"
            )
        return count

    def step(self, old: State, new: State, controls: Controls) -> None:
        self._kernel.advance(old, new, controls, self._felt, self.substeps, self.threads)
