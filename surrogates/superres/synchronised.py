"""A fine cloth that is pulled along with a coarse one: pairs that differ in wrinkles alone (Chen et al. 2020, 4.2)."""

from collections.abc import Sequence

import _minicloth_kernels as kernels
import numpy as np

from cloth_envs.arguments import as_number, one_of, whole_number
from cloth_envs.material import Material
from cloth_envs.physics.explicit.solver import ExplicitSolver
from cloth_envs.resample import means, weights
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from surrogates.miniature.coarse import CoarsePhysics

RATES = {"mean": 120.0, "seed": 200.0}  # tracking -> 1/s of its springs
DAMPING = 0.7  # of them, over the critical one


class Synchronised(ExplicitSolver):
    """The explicit solver's cloth, its accelerations those of its own and ``w^2 (q - y) + 2 z w (q' - y')``.

    The coarse cloth ``p`` (``CoarsePhysics`` under the same controls) moves freely, on cubics through each frame.
    ``"mean"``: ``y = W x`` are means of the fine cloth around coarse vertices, ``q = W U p``, and what they are
    accelerated by is spread by the hats of ``U``, bilinear interpolation (after the test functions of Kavan et al.
    2011). ``"seed"`` (eq. 1 of Chen et al. and their section 4.2): ``y`` are the vertices that both cloths share, ``q =
    p``, and the springs, dashpots and bending of a coarse sheet between them act on them too, twice as many substeps.

    Args:
        scene: at full resolution. num_envs, threads, dtype: as of every solver.
        factor: how many times fewer cells the coarse cloth has along each side.
        tracking: ``"mean"`` or ``"seed"``.
        rate, damping: ``w`` [1/s] and ``z``; by default 120 and 200, and 0.7.
        levels: how much of the coarse sheet's own forces acts, of ``"seed"`` (1; 0 for springs alone).

    Raises:
        ValueError: a bad argument, or ``"seed"`` with a factor that does not divide the fine cells.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        num_envs: int = 1,
        threads: int = 1,
        dtype: str = "float32",
        factor: int = 4,
        tracking: str = "mean",
        rate: float | None = None,
        damping: float = DAMPING,
        levels: float = 1.0,
    ) -> None:
        one_of("tracking", tracking, RATES)
        means_of = tracking == "mean"
        numbers = {"rate": RATES[tracking] if rate is None else rate, "damping": damping, "levels": levels}
        for name, value in numbers.items():
            number = as_number(value)
            if number is None or not 0 <= number < np.inf or (name == "rate" and number == 0):
                raise ValueError(f"{name} must be a {'positive ' if name == 'rate' else ''}number, got {value!r}")
        apart = whole_number("factor", factor)
        super().__init__(
            scene, num_envs=num_envs, threads=threads, dtype=dtype, refine=1 if means_of or levels == 0 else 2
        )
        options = {"threads": threads, "dtype": dtype}
        self._coarse = CoarsePhysics(scene, num_envs=num_envs, factor=apart, options=options)
        coarse = self._coarse.scene.grid
        if not means_of and any(fine % cells for fine, cells in zip(scene.grid.cells, coarse.cells, strict=True)):
            raise ValueError(
                f"tracking='seed' pulls shared vertices, and {scene.grid} shares none with {coarse}: choose a factor "
                "that divides its cells, or tracking='mean'"
            )
        hats = weights(coarse, scene.grid, "linear")
        self._target = None
        if means_of:
            self._target = [w @ u for w, u in zip(means(scene.grid, coarse), hats, strict=True)]
        self.tracking = kernels.Tracking(down=hats[0], across=hats[1], means=means_of, **numbers)

    @property
    def coarse(self) -> State:
        """The present coarse cloth; never changed afterwards."""
        return self._coarse.state

    @property
    def coarse_scene(self) -> Scene:
        return self._coarse.scene

    def check_material(self, material: Material) -> None:
        """Refuse what either cloth can't be made of. Raises ValueError: says what to change."""
        super().check_material(material)
        self._coarse.check_material(material)

    def reset(
        self, state: State, materials: Sequence[Material] | None = None, which: Sequence[int] | None = None
    ) -> None:
        self._coarse.reset(state, materials, which)
        super().reset(state, materials, which)

    def disturb(self, state: State) -> None:
        """Go on with other fine cloths, the coarse ones stay."""
        self._begin(state.astype(self.dtype), None)

    def advance(self, controls: Controls) -> State:
        ways = [self.aims(self._coarse.state), self.aims(self._coarse.advance(controls))]
        assert self.tracking is not None
        self.tracking.aim(*ways[0], *ways[1], self.scene.frame_dt)
        return super().advance(controls)

    def aims(self, coarse: State) -> tuple[np.ndarray, np.ndarray]:
        """Where what is pulled should be while the coarse cloths are so, and how fast, ``(B, 3, h, w)`` each."""
        cloth = [field.astype(np.float64) for field in (coarse.positions, coarse.velocities)]
        if self._target is not None:
            rows, columns = self._target
            cloth = [np.einsum("rh,...hw,cw->...rc", rows, field, columns, optimize=True) for field in cloth]
        return cloth[0], cloth[1]

    @property
    def memory(self) -> dict[str, np.ndarray]:
        """The coarse cloths."""
        return self._coarse.memory

    def recall(self, memory: dict[str, np.ndarray]) -> None:
        self._coarse.recall(memory)
