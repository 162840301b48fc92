"""How long the steps of the explicit solver may be, and for how many of them slow forces are held."""

from functools import lru_cache

import numpy as np

from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.physics.laws.stencil import edges
from cloth_envs.physics.solver import PRESSURE, air_bound, pressure_bound, stiffness_bound
from cloth_envs.scene import Scene

SAFETY = 0.9
# How frames are cut: shear for which steps are counted [rad], how many times as many are taken, and the sine of cells'
# shear at a frame's start and end up to which that holds. What is over 1 is stretched as well, as by steps that were
# too long.
LEVELS = ((np.radians(15.0), 1, 0.5), (np.pi / 2, 1, 1.2), (np.pi / 2, 4, np.inf))
FAST, SLACK = 0.3, 0.1  # of waves' speed, and of a cell that they go in a step: see ``parting``
LIMIT, PATCH = 0.99, 7  # the safety of a sheet sheared as far as the first of LEVELS holds, and how many rows it has
UNDAMPED = 0.02  # damping times the largest frequency, below which nothing takes what a few sheared cells give
RESONANCE = 12.0  # what slow forces, held, may do to fast waves over what damping takes of them, as in ``interval``
HELD = 7  # substeps for which slow forces are held: docs/solvers.md has what more would save and cost

_P, _Q = np.meshgrid(*2 * [np.linspace(-np.pi, np.pi, 33)])
WAVES = 2 - 2 * np.cos([_Q.ravel(), _P.ravel(), (_P + _Q).ravel(), (_P - _Q).ravel()])  # along columns, rows, diagonals


def directed_bound(scene: Scene, material: Material, shear: float) -> float:
    """Largest eigenvalue of ``M^-1 K`` for springs that act along themselves only [1/s^2].

    ``K`` of a spring is ``k d d^T``, ``d`` its direction: what neighbours along a row and along a column do to a vertex
    does not add up, as in ``stiffness_bound``. On an even grid waves ``exp(i (p r + q c))`` are eigenvectors, but for
    its borders (``border_bound``). The largest over all waves, of flat cells and of cells sheared by ``shear`` [rad],
    at 90 degrees the bound of ``stiffness_bound``, borders included; cloth with next to no damping is bounded for
    these.
    """
    grid, worst = scene.grid, 0.0
    a, b, stretch = grid.row_spacing, grid.col_spacing, material.stretch_stiffness
    diagonal = material.shear_stiffness * (a * a + b * b) / (2 * a * b)
    stiffness = np.array([stretch * a / b, stretch * b / a, diagonal, diagonal])
    undamped = material.damping * np.sqrt(stiffness_bound(scene, material)[0]) < UNDAMPED
    for angle in (0.0, np.pi / 2 if undamped else shear):
        col, row = np.array([b, 0.0]), a * np.array([np.sin(angle), np.cos(angle)])
        x, y = np.array([col, row, row + col, row - col]).T
        xx, yy, xy = stiffness / (x * x + y * y) * [x * x, y * y, x * y] @ WAVES
        worst = max(worst, float(((xx + yy) / 2 + np.hypot((xx - yy) / 2, xy)).max()))
    return worst / (material.areal_density * a * b)


@lru_cache(maxsize=1024)
def free_bound(grid: Grid, shear: float, angle: float) -> float:
    """Largest eigenvalue of ``M^-1 K`` of a whole free sheet, of stretch stiffness 1 N/m and 1 kg/m^2 [1/s^2].

    Its springs act along themselves, its cells are sheared by ``angle`` [rad], ``shear`` [N/m] is its shear stiffness.
    At a free border what the two diagonals of a cell do across each other has no counterpart: with a shear as stiff as
    the stretch, the largest eigenvalue is 5 % over that of all waves on flat square cells, 10 % on sheared ones.
    """
    c, r = np.meshgrid(np.arange(grid.cols) * grid.col_spacing, np.arange(grid.rows) * grid.row_spacing)
    at = np.stack([c + r * np.sin(angle), r * np.cos(angle)], -1).reshape(-1, 2)
    mass, blocks = np.sqrt(grid.areas.ravel()), []
    for edge in edges(grid):
        d, number = at[edge.second] - at[edge.first], np.arange(len(edge.first))
        k = edge.weight * (1.0 if edge.modulus == "stretch_stiffness" else shear)
        pull = d * (np.sqrt(k) / np.linalg.norm(d, axis=1))[:, None]
        block = np.zeros((len(d), grid.vertices, 2))
        block[number, edge.first] = -pull / mass[edge.first, None]
        block[number, edge.second] = pull / mass[edge.second, None]
        blocks.append(block.reshape(len(d), -1))
    springs = np.concatenate(blocks)
    return float(np.linalg.eigvalsh(springs.T @ springs)[-1])


def border_bound(scene: Scene, material: Material) -> float:
    """The larger ``free_bound`` of the flat sheet and of one sheared as far as the first of ``LEVELS`` holds [1/s^2].

    Of a sheet of at most 7 x 7 vertices: what a border adds decays within 3 cells.
    """
    a, b = scene.grid.row_spacing, scene.grid.col_spacing
    rows, cols = min(PATCH, scene.grid.rows), min(PATCH, scene.grid.cols)
    patch = Grid(rows, cols, (rows - 1) * a / b, cols - 1.0)
    ratio = material.shear_stiffness / material.stretch_stiffness
    worst = max(free_bound(patch, ratio, angle) for angle in (0.0, float(np.arcsin(LEVELS[0][2]))))
    return worst * material.stretch_stiffness / (material.areal_density * b * b)


@lru_cache(maxsize=1024)  # an environment asks before it sets a material
def stable_step(
    scene: Scene, material: Material, pressure: float = PRESSURE, speed: float = 0.0, shear: float = LEVELS[0][0]
) -> float:
    """The step ``h`` [s] for which ``h^2 K + 2 h C <= 4 M``, with safety.

    With the damping force taken at the velocity half a step before, each mode has the
    characteristic polynomial ``z^2 - (2 - h c - h^2 k) z + (1 - h c)``; its roots stay in the unit
    circle while ``h^2 k + 2 h c <= 4``. ``k`` holds springs, bending and, where the scene has it,
    ``pressure`` [Pa]; ``c`` the dashpots (``damping`` times the springs' stiffness) and the slope of the air's force
    (``air_bound``) up to ``speed`` [m/s]. Every spring adds the larger of what it adds lengthened and
    shortened, so the step is the smaller one of a sheet of either.

    Of springs ``directed_bound`` of ``shear`` [rad] counts, with a safety of 0.9, and ``border_bound``, as far as cells
    are sheared before frames are cut otherwise, with one of 0.99.
    """
    waves, border = directed_bound(scene, material, shear), border_bound(scene, material)
    other = stiffness_bound(scene, material)[1] + pressure_bound(scene, material, pressure)
    air = air_bound(scene, material, pressure, speed)

    def step(springs: float, stiffness: float, damping: float) -> float:
        k, c = stiffness * springs + other, damping * material.damping * springs + air
        return 2 / (np.sqrt(c * c / 4 + k) + c / 2)

    def both(springs: float) -> float:
        return min(step(springs, 1, 1), step(springs, material.compression, material.compression_damping))

    return min(SAFETY * both(waves), LIMIT * both(border))


def parting(scene: Scene, material: Material, h: float) -> float:
    """Speed of neighbours over each other [m/s] over which a frame is cut as by the last of ``LEVELS``.

    ``FAST`` of that of waves along threads, whatever the shear: cells of a coarse grid turn over and back within a
    frame. None where waves go less than ``SLACK`` of a cell in a step of ``h`` [s]: that is short enough.
    """
    wave = np.sqrt(material.stretch_stiffness / material.areal_density)
    slack = wave * h < SLACK * min(scene.grid.row_spacing, scene.grid.col_spacing)
    return np.inf if slack else float(FAST * wave)


@lru_cache(maxsize=1024)
def interval(
    scene: Scene, material: Material, h: float, pressure: float = PRESSURE, speed: float = 0.0, *, loose: bool = False
) -> int:
    """For how many substeps of ``h`` [s] bending, the air and pressure can be held, 1 at least.

    Held for a time T at the position ``T / 2`` ahead, a force of frequency ``w`` neither gains nor takes energy while
    ``w T < 2``: here below 1. The air, at velocities extrapolated by ``T / 2``, is stable for rates ``c T < 1``; below
    1/2 it is as exact as the step.

    To waves of springs with frequencies ``w`` over ``2 / T``, of which the held force knows nothing, it gives energy at
    a rate of up to ``slow / w``, while damping takes ``damping w^2 / 2``: ``slow T^3 / damping`` must stay small. That
    of bending is below ``RESONANCE``, with the damping of springs that are short as often as long; pressure gives far
    less, and counts where nothing is damped. Held for one substep a force is part of the step.
    """
    bending, pushed = stiffness_bound(scene, material)[1], pressure_bound(scene, material, pressure)
    air = air_bound(scene, material, pressure, speed) * (1 if loose else 2)
    damping = material.damping * (1 + material.compression_damping) / 2
    fast = np.cbrt(bending / (RESONANCE * damping)) if damping > 0 else np.sign(bending + pushed) / h
    return max(int(min(1000, 1 / max(h * max(np.sqrt(bending + pushed), air, fast), 1e-9))), 1)
