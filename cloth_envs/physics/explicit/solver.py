"""The default reference solver: velocity Verlet at the largest stable step, compiled."""

from collections.abc import Sequence

import _minicloth_kernels as kernels
import numpy as np

from cloth_envs.material import Material
from cloth_envs.physics.explicit.bounds import LEVELS, parting
from cloth_envs.physics.explicit.cuts import FrameCuts
from cloth_envs.physics.laws.diagnostics import strains
from cloth_envs.physics.solver import PRESSURE, STRETCH, Solver, fastest, kernel_material, kernel_sheet
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State

BREEZE = 5.0  # Pa, which bursts no cloth: what is not finite then has another cause
SOUND = 340.0  # m/s, to which the law of the air reaches at most


def _rounded(value: float) -> float:
    """A little up, so that there are few different ones."""
    return float(2 ** (np.ceil(4 * np.log2(value)) / 4))


class ExplicitSolver(Solver):
    """Velocity Verlet in equal substeps of a frame; bending and the air are computed every few of them.

    The number of substeps comes from a bound on the spectrum (``stable_step``), so every
    material that is not refused is stable; a frame in a pressure of over 100 Pa, or of something faster than 12 m/s and
    twice the wind, is stepped in as many more as that needs, and one at whose start or end cells are sheared by over 30
    degrees in about 1.3 times as many, or, where they are stretched as well, neighbours part at over 0.3 times the
    speed of waves along threads, or something is not finite, four times those, nothing held. Handles and bodies move on
    cubics through the frame. ``crossings`` ``(B,)`` counts the pairs of triangles that crossed as the last frame began,
    0 without self-contact. ``tracking`` is what pulls the cloths along with others, aimed at every frame before it is
    stepped, None by default.

    Args, beside those of ``Solver``:
        substeps: per frame, instead of the largest stable step; not below the stable number of cloth that is sheared
            by up to 30 degrees, more where it is sheared further and needs them.
        refine: multiplies the number of substeps (4 for truth).
        held: for how many substeps bending and the air are held, at most; fewer where they would not be stable. By
            default up to 7, fewer where the air's rate or a lack of damping asks for it: as exact as the step.

    Raises:
        ValueError: a bad argument, or a material so stiff or light (in ``advance``: a pressure so large) that a frame
            would need more than 20,000 substeps, or more than ``substeps``; a cloth burst by a pressure.
    """

    yields, self_contact = True, True

    def __init__(
        self,
        scene: Scene,
        *,
        num_envs: int = 1,
        threads: int = 1,
        dtype: str = "float32",
        substeps: int | None = None,
        refine: int = 1,
        held: int | None = None,
    ) -> None:
        super().__init__(scene, num_envs=num_envs, threads=threads, dtype=dtype)
        self._cutter = FrameCuts(scene, substeps=substeps, refine=refine, held=held)
        self._fastest = fastest(scene)
        kernel = kernels.Explicit32 if self.dtype == np.float32 else kernels.Explicit64
        self._kernel = kernel(kernel_sheet(scene), [most for *_, most in LEVELS])
        self._stepped = [scene.material] * num_envs
        self._felt = [kernel_material(scene.material)] * num_envs
        self._cuts = self._last = np.ones((num_envs, len(LEVELS), 2), np.int32)
        self._levels, self._parting = np.zeros(num_envs, np.int32), [np.inf] * num_envs
        self.crossings = np.zeros(num_envs, np.int32)
        self.tracking: kernels.Tracking | None = None
        self.set_materials(range(num_envs), [scene.material] * num_envs)

    def check_material(self, material: Material) -> None:
        super().check_material(material)
        self._cutter.count(material)

    @property
    def cuts(self) -> np.ndarray:
        """How frames of cloth that nothing shears far, blows at or hits are cut, ``(B, 2)``.

        Substeps, and for how many of them slow forces are held.
        """
        return self._cuts[:, 0]

    @property
    def substeps(self) -> np.ndarray:
        """In such a frame of each cloth, ``(B,)``."""
        return self.cuts[:, 0]

    @property
    def last_cuts(self) -> np.ndarray:
        """How the last frame was cut, ``(B, 2)``."""
        return self._last[np.arange(self.num_envs), self._levels]

    def set_materials(self, which: Sequence[int], materials: Sequence[Material]) -> None:
        for i, m in zip(which, materials, strict=True):
            self._stepped[i], self._felt[i], self._cuts[i] = m, kernel_material(m), self._cutter(m)
            self._parting[i] = parting(self.scene, m, self.scene.frame_dt / int(self.substeps[i]))

    def _cuts_of(self, old: State, controls: Controls, speeds: Sequence[float] = ()) -> np.ndarray:
        """``_cuts`` of the frame from ``old``, in which something has ``speeds`` ``(B,)`` [m/s] if they are given.

        What pressure does grows with the edges' lengths: they may double in a frame. Speeds may grow to four times
        theirs where something is hit, and the air moves at up to ``max_wind`` against them; more than that of sound is
        not counted on.
        """
        scene, pressure = self.scene, abs(controls.pressure)
        high = pressure > PRESSURE if scene.pressure else np.zeros(len(pressure), bool)
        fast = np.array(speeds) > self._fastest if speeds else np.zeros(len(pressure), bool)
        if not (high | fast).any():
            return self._cuts
        cuts = self._cuts.copy()
        for i in np.flatnonzero(high | fast).tolist():
            load, speed, cause = PRESSURE, 0.0, "this material"
            if fast[i] and scene.air:
                speed = _rounded(min(4 * speeds[i] + scene.air.max_wind, SOUND))
                cause = f"a speed of {speeds[i]:.3g} m/s"
            if high[i]:
                with np.errstate(all="ignore"):
                    stretch = 1 + strains(scene.grid, old.positions[[i]]).max()
                    load = _rounded(pressure[i] * max(2 * stretch / STRETCH, 1.0))
                cause = f"a pressure of {controls.pressure[i]:g} Pa on cloth that it stretched {stretch:.3g} times"
            cuts[i] = self._cutter(self._stepped[i], load, speed, cause)
        return cuts

    def _levels_of(self, state: State) -> np.ndarray:
        """Which of ``LEVELS`` holds each cloth."""
        return np.array(self._kernel.levels(state.positions, state.velocities, self._parting))

    def step(self, old: State, new: State, controls: Controls) -> None:
        self._last = self._cuts_of(old, controls) if self.scene.pressure else self._cuts
        given, found = (old, new, controls, self._felt), np.zeros_like(self._levels)
        self.crossings = np.zeros_like(self._levels)
        told = (self._parting, found, self.crossings)
        speeds = self._kernel.advance(*given, self._last, *told, self._fastest, self.threads, self.tracking)
        if speeds:
            self._last = self._cuts_of(old, controls, speeds)
            self._kernel.advance(*given, self._last, *told, np.inf, self.threads, self.tracking)
        self._levels = found
        blown = self.scene.pressure and abs(controls.pressure).max() > BREEZE
        if blown and not np.isfinite(new.positions.sum()):
            raise ValueError(
                f"a pressure of {abs(controls.pressure).max():g} Pa burst the cloth: lower it, raise the cloth's "
                "stretch_stiffness, or give a larger refine"
            )
