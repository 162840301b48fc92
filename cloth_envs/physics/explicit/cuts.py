"""How many substeps a frame is cut into, and for how many of them slow forces are held."""

import numpy as np

from cloth_envs.arguments import whole_number
from cloth_envs.material import Material
from cloth_envs.physics.explicit.bounds import HELD, LEVELS, interval, stable_step
from cloth_envs.physics.solver import PRESSURE
from cloth_envs.scene import Scene

MAX_SUBSTEPS = 20_000  # per frame


class FrameCuts:
    """The cuts of a scene's frames, of a material, a pressure and a speed.

    Args, as ``ExplicitSolver`` has them: ``substeps``, ``refine`` and ``held``.

    Raises:
        ValueError: one that is no whole number over zero.
    """

    def __init__(self, scene: Scene, *, substeps: int | None = None, refine: int = 1, held: int | None = None) -> None:
        self._scene = scene
        self._refine = whole_number("refine", refine)
        self._held = None if held is None else whole_number("held", held)
        self._wanted = None if substeps is None else whole_number("substeps", substeps)

    def __call__(
        self, material: Material, pressure: float = PRESSURE, speed: float = 0.0, cause: str = "this material"
    ) -> list[tuple[int, int]]:
        """How a frame is cut for each of ``LEVELS``. Raises ValueError: see ``count``."""
        scene, first, cuts = self._scene, self.count(material, pressure, speed, cause), []
        for shear, times, _ in LEVELS:
            least = int(np.ceil(scene.frame_dt / stable_step(scene, material, pressure, speed, shear)))
            count = max(first, least * self._refine) * times
            h = scene.frame_dt / count
            held = interval(scene, material, h, pressure, speed, loose=self._held is not None)
            most = HELD if self._held is None else self._held
            cuts.append((count, min(held, most) if times == 1 else 1))  # in the last anything may be fast in air
        return cuts

    def count(
        self, material: Material, pressure: float = PRESSURE, speed: float = 0.0, cause: str = "this material"
    ) -> int:
        """Substeps in a frame. Raises ValueError: more than the limit, or fewer wanted than are stable."""
        least = np.ceil(self._scene.frame_dt / stable_step(self._scene, material, pressure, speed))
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
