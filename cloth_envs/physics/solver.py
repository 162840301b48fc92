"""What the reference solvers share, and the choice of one by name."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar

import _minicloth_kernels as kernels
import numpy as np

from cloth_envs.arguments import float_type, one_of, whole_number
from cloth_envs.backend import Backend, Stateful, check_keywords, keywords
from cloth_envs.material import Material
from cloth_envs.naming import resolve
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State

# name -> "module:Solver class", resolved on use.
SOLVERS: dict[str, str] = {
    "admm": "cloth_envs.physics.admm.solver:AdmmSolver",
    "explicit": "cloth_envs.physics.explicit.solver:ExplicitSolver",
    "implicit": "cloth_envs.physics.implicit.solver:ImplicitSolver",
}

# The same for a net of particles.
PARTICLE_SOLVERS: dict[str, str] = {
    "explicit": "cloth_envs.physics.particles.solver:ParticleSolver",
}

FASTEST = 12.0  # m/s, of a swung cloth's triangles
PRESSURE = 100.0  # Pa, up to which every step is short enough
STRETCH = 2.0  # of the longest edge over its rest length, in the bound on what pressure does
CONDITION = 0.5  # of an implicit step's matrix, over what the digits can tell


def solvers_of(scene: Scene) -> dict[str, str]:
    """Those that step the scene: a sheet, or a net of particles."""
    return SOLVERS if scene.particles is None else PARTICLE_SOLVERS


def reference(
    scene: Scene, *, num_envs: int = 1, solver: str = "explicit", threads: int = 1, **options: Any
) -> Backend:
    """The backend ``"reference"``: ``solver`` by name, built with its own ``options``.

    ``threads`` are over members of the batch, where the solver has any; results do not depend on them.

    Raises:
        ValueError: an unknown solver or option (the nearest match is named), or one that can't step the scene.
    """
    one_of("solver", solver, SOLVERS)
    table = solvers_of(scene)
    if solver not in table:
        raise ValueError(
            f"solver={solver!r} steps sheets, this preset of {scene.name} is a net of particles: "
            f"leave solver out or choose {', '.join(map(repr, table))}"
        )
    chosen = resolve(table[solver])
    if "threads" in keywords(chosen):
        options["threads"] = threads
    check_keywords(chosen, options, f"solver={solver!r}")
    return chosen(scene, num_envs=num_envs, **options)


def kernel_sheet(scene: Scene) -> kernels.Sheet:
    """What every compiled solver is told of a scene; balls of a net of particles have no thickness."""
    grid, air = scene.grid, scene.air
    return kernels.Sheet(
        rows=grid.rows,
        cols=grid.cols,
        row_length=grid.row_spacing,
        col_length=grid.col_spacing,
        periodic=grid.periodic,
        frame_dt=scene.frame_dt,
        gravity=scene.gravity,
        thickness=scene.thickness if scene.particles is None else 0.0,
        self_thickness=scene.layer,
        self_friction=scene.self_contact.friction if scene.self_contact else 0.0,
        air=air is not None,
        pressure=scene.pressure,
        air_normal=air.density * air.normal if air else 0.0,
        air_lift=air.density * air.lift if air else 0.0,
        air_tangential=air.density * air.tangential if air else 0.0,
        handles=list(scene.handles),
        hold=scene.holding.hold.ravel().tolist(),
        lead=scene.holding.lead.tolist(),
        bodies=[
            kernels.Body(
                plane=body.kind == "plane",
                radius=body.radius,
                friction=body.friction,
                turns_with=-1 if body.turns_with is None else body.turns_with,
            )
            for body in scene.colliders
        ],
    )


def kernel_material(material: Material) -> kernels.Material:
    """A material as compiled solvers take it."""
    return kernels.Material(**material.as_dict())


def stiffness_bound(scene: Scene, material: Material) -> tuple[float, float]:
    """Upper bounds on the eigenvalues of ``M^-1 K`` for springs and for bending [1/s^2].

    A spring's Hessian never exceeds its stiffness times the identity, however the cloth is folded or
    stretched, so the scalar graph Laplacian bounds every configuration. Its largest eigenvalue is at
    most the largest of any one cell's with that cell's lumped masses (Irons & Treharne 1971); all
    cells of a grid are equal, and a 4 x 4 problem remains. Bending has at most the symbol of a plate,
    ``B (s_a^2 / a^4 + s_b^2 / b^4 + 2 twist s_a s_b / (a b)^2)`` with ``s = 2 - 2 cos <= 4``.
    """
    g = scene.grid
    a, b = g.row_spacing, g.col_spacing
    along, down = material.stretch_stiffness * a / b / 2, material.stretch_stiffness * b / a / 2
    shear = material.shear_stiffness * (a * a + b * b) / (2 * a * b)
    laplacian = np.zeros((4, 4))
    edges = [(0, 1, along), (2, 3, along), (0, 2, down), (1, 3, down), (0, 3, shear), (1, 2, shear)]
    for i, j, k in edges:
        laplacian[i, i] += k
        laplacian[j, j] += k
        laplacian[i, j] -= k
        laplacian[j, i] -= k
    quarter = material.areal_density * a * b / 4
    springs = float(np.linalg.eigvalsh(laplacian)[-1]) / quarter
    bending = 16 * (a**-4 + b**-4 + 2 * material.twist / (a * b) ** 2) * material.bend_stiffness
    return springs, bending / material.areal_density


def fastest(scene: Scene, pressure: float = PRESSURE) -> float:
    """Speed through the air [m/s] up to which every step is short enough.

    Twice the fastest wind's, ``FASTEST`` at least, and what a ``pressure`` [Pa] can drive cloth to, at which
    ``rho/2 C_n v^2`` balances it.
    """
    air = scene.air
    if air is None:
        return np.inf
    driven = scene.pressure and air.density * air.normal > 0
    pushed = np.sqrt(2 * abs(pressure) / (air.density * air.normal)) if driven else 0.0
    return float(max(2 * air.max_wind, FASTEST) + pushed)


def air_bound(scene: Scene, material: Material, pressure: float = PRESSURE, speed: float = 0.0) -> float:
    """Upper bound on the slope of the air's force over the velocity and the mass [1/s].

    Cloth moves through the air at up to ``speed`` [m/s], ``fastest`` at least. A cell's force has the slopes
    ``rho/2 A`` times ``2 C_n |u_n| + C_l |u_t|`` and ``C_l u_n`` along its normal, ``2 C_t |u_t|`` and ``C_t |u_t|``
    in its plane. The norm of their matrix over ``rho A |u|`` is at most
    ``(C_n^2 + C_l^2 / 2 + C_t^2)^(1/2)``, without lift the larger one of ``C_n`` and ``C_t``.
    """
    if scene.air is None:
        return 0.0
    air = scene.air
    slope = max(air.normal, air.tangential)
    if air.lift > 0:
        slope = np.sqrt(air.normal**2 + air.lift**2 / 2 + air.tangential**2)
    return float(air.density * slope * max(fastest(scene, pressure), speed) / material.areal_density)


def pressure_bound(scene: Scene, material: Material, pressure: float = PRESSURE) -> float:
    """Upper bound on ``M^-1 K`` of a pressure up to ``pressure`` [Pa] either way [1/s^2].

    A facet's force on each of its corners is ``p / 12 (x1 - x0) x (x2 - x0)``, whose slope has the norm
    ``p / 12 sqrt(3 (e0^2 + e1^2 + e2^2))``, symmetric or not, with the edges ``e``: of a right triangle at rest
    ``p d / sqrt 24``. A corner lies in three of a cell's four facets: ``sqrt(3 / 8) p d`` over a quarter of a cell's
    mass.
    """
    if not scene.pressure:
        return 0.0
    grid = scene.grid
    mass = material.areal_density * grid.row_spacing * grid.col_spacing
    return float(np.sqrt(6) * STRETCH * abs(pressure) * grid.diagonal / mass)


def check_condition(scene: Scene, material: Material, h: float, dtype: np.dtype) -> None:
    """Refuse a material whose implicit step ``h`` [s] has a matrix that ``dtype`` can't solve.

    Over the mass, its eigenvalues lie between 1 and ``1 + h^2 K + h C``, where float32 tells seven digits.

    Raises:
        ValueError: says what to change.
    """
    springs, bending = stiffness_bound(scene, material)
    found = 1 + h * h * (springs + bending) + h * material.damping * springs
    most = CONDITION / float(np.finfo(dtype).eps)
    if not found < most:
        raise ValueError(
            f"this material makes an implicit step too stiff for {dtype} (condition {found:.2g}, at most {most:.2g}): "
            "lower its stiffness or damping, raise its areal_density, use substeps or a coarser resolution"
        )


class Solver(Stateful, ABC):
    """A batch of cloths of one scene and its state; a solver adds how a frame is stepped.

    Args:
        scene: what is modelled; terms that it does not list are not evaluated.
        num_envs: members of the batch.
        threads: over members of the batch; results do not depend on it.
        dtype: of the state, ``"float32"`` or ``"float64"``, or NumPy's type of that name.
    """

    yields: ClassVar[bool] = False  # to compression, as ``Material.yields`` says
    self_contact: ClassVar[bool] = False  # whether it models ``Scene.self_contact``

    def __init__(self, scene: Scene, *, num_envs: int = 1, threads: int = 1, dtype: str = "float32") -> None:
        self.scene, self.num_envs = scene, whole_number("num_envs", num_envs)
        self.threads, self.dtype = whole_number("threads", threads), float_type(dtype)

    def check_material(self, material: Material) -> None:
        """Refuse what this solver can't step; a solver adds its own limits. Raises ValueError: says what to change."""
        if material.yields and not self.yields:
            raise ValueError(
                f"{type(self).__name__} has no springs that yield under compression: use solver='explicit', "
                "or leave the material's compression, post_buckling and compression_damping at 1"
            )

    @abstractmethod
    def set_materials(self, which: Sequence[int], materials: Sequence[Material]) -> None:
        """Prepare some members for new materials, which ``check_material`` let through; off the hot path."""

    @abstractmethod
    def step(self, old: State, new: State, controls: Controls) -> None:
        """One frame: fill ``new.positions`` and ``new.velocities``, everything else of it is set."""

    def reset(
        self,
        state: State,
        materials: Sequence[Material] | None = None,
        which: Sequence[int] | None = None,
    ) -> None:
        members = range(self.num_envs) if which is None else which
        if state.batch != len(members):
            raise ValueError(f"the state holds {state.batch} cloths, expected {len(members)}")
        chosen = [self.scene.material] * len(members) if materials is None else list(materials)
        for material in set(chosen):
            self.check_material(material)
        self.set_materials(members, chosen)
        self._begin(state.astype(self.dtype), which)

    def advance(self, controls: Controls) -> State:
        old = self.state
        x, v, bodies, moving, time = kernels.next_frame(
            old.positions, old.time, controls.colliders, controls.collider_velocities, self.scene.frame_dt
        )
        new = State(x, v, bodies, moving, controls.wind, controls.pressure, time)
        self.step(old, new, controls)
        self._state = new
        return new
