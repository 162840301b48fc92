"""What a state is worth: energies, momenta, strains, penetration. Vectorised NumPy in float64, one row a cloth.

Forces and energies are those of ``physics.laws``. ``materials`` holds one ``Material`` per cloth and
defaults to the scene's. What happens between states (work, residual, slow motion) is in ``physics.budget``.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.physics.laws import air, sheet
from cloth_envs.physics.laws.bodies import axis_parameter, dot, on_axis
from cloth_envs.physics.laws.stencil import edges
from cloth_envs.scene import Scene
from cloth_envs.state import State


@dataclass(frozen=True)
class Energy:
    """Energies ``(B,)`` [J]."""

    kinetic: np.ndarray  # ``sum m |v|^2 / 2``
    gravity: np.ndarray  # ``sum m g z``, zero at z = 0
    springs: np.ndarray  # stretch and shear, ``sum k (|d| - L)^2 / 2``
    bending: np.ndarray  # Bergou et al. 2006
    # ``-p V``, V the volume between the cloth and the origin, p the last frame's; its gradient is the force of pressure
    # where the border is fixed (or there is none). 0 in a scene without.
    pressure: np.ndarray

    @property
    def mechanical(self) -> np.ndarray:
        """Kinetic, gravity, springs and bending; what pressure adds to these is work."""
        return self.kinetic + self.gravity + self.springs + self.bending


def as_materials(scene: Scene, state: State, materials: Sequence[Material] | None) -> Sequence[Material]:
    """``materials``, or the scene's for every cloth.

    Raises:
        ValueError: their number is not the state's, or the scene is a net of particles.
    """
    if scene.particles is not None:
        raise ValueError(f"{scene.name} is a net of particles, whose energies these are not: leave its preset out")
    if materials is None:
        return [scene.material] * state.batch
    if len(materials) != state.batch:
        raise ValueError(f"{len(materials)} materials for {state.batch} cloths: give one for each")
    return materials


def energy(scene: Scene, state: State, materials: Sequence[Material] | None = None) -> Energy:
    """The energies of every cloth."""
    sheets, grid, x = as_materials(scene, state, materials), scene.grid, state.positions
    return Energy(
        kinetic=sheet.kinetic_energy(grid, sheets, state.velocities),
        gravity=sheet.gravity_energy(grid, sheets, x, scene.gravity),
        springs=sheet.spring_energy(grid, sheets, x),
        bending=sheet.bend_energy(grid, sheets, x),
        pressure=air.pressure_energy(grid, x, state.pressure) if scene.pressure else np.zeros(state.batch),
    )


def linear_momentum(scene: Scene, state: State, materials: Sequence[Material] | None = None) -> np.ndarray:
    """``sum m v``, ``(B, 3)`` [kg m/s]."""
    mass = sheet.masses(scene.grid, as_materials(scene, state, materials))
    return (mass * state.velocities).sum((2, 3))


def angular_momentum(
    scene: Scene, state: State, materials: Sequence[Material] | None = None, *, about: ArrayLike = (0.0, 0.0, 0.0)
) -> np.ndarray:
    """``sum m (x - about) x v``, ``(B, 3)`` [kg m^2/s]; ``about`` ``(3,)`` or ``(B, 3)`` [m]."""
    mass = sheet.masses(scene.grid, as_materials(scene, state, materials))
    arm = state.positions - np.asarray(about, np.float64)[..., None, None]
    return np.cross(arm, mass * state.velocities, axis=1).sum((2, 3))


@dataclass(frozen=True)
class Strain:
    """Statistics ``(B,)`` of the size of the edges' strain, ``||d| / L - 1|``; NaN where a position is not finite."""

    mean: np.ndarray
    p99: np.ndarray
    max: np.ndarray


def strains(grid: Grid, positions: np.ndarray, *, shear: bool = False) -> np.ndarray:
    """``|d| / L - 1``, ``(B, E)``, of the structural edges (rows' and columns'), or of the diagonals with ``shear``."""
    flat = positions.astype(np.float64).reshape(len(positions), 3, -1)
    chosen = [edge for edge in edges(grid) if (edge.modulus == "shear_stiffness") == shear]
    parts = [np.linalg.norm(flat[..., e.second] - flat[..., e.first], axis=1) / e.rest - 1 for e in chosen]
    return np.concatenate(parts, axis=1)


def strain(grid: Grid, positions: np.ndarray, *, shear: bool = False) -> Strain:
    """Mean, 99th percentile and largest strain of every cloth ``positions`` ``(B, 3, H, W)``."""
    size = abs(strains(grid, positions, shear=shear))
    return Strain(size.mean(1), np.percentile(size, 99, axis=1), size.max(1))


@dataclass(frozen=True)
class Penetration:
    """Vertices that are too near to a body, or in it, ``(B,)``."""

    mean: np.ndarray  # depth over these vertices [m]; 0 where there are none
    max: np.ndarray  # the deepest [m]
    count: np.ndarray  # how many


def depths(scene: Scene, state: State, *, thickness: float | None = None) -> np.ndarray:
    """How far each vertex is short of ``thickness`` (default: the scene's) from the nearest body, ``(B, H * W)`` [m].

    Negative where it is farther; ``-inf`` in a scene without bodies. At thickness 0 it is the depth in the bodies
    themselves.
    """
    keep = scene.thickness if thickness is None else thickness
    x = state.positions.astype(np.float64).reshape(state.batch, 3, -1)
    deepest = np.full((state.batch, x.shape[2]), -np.inf)
    for number, body in enumerate(scene.colliders):
        ends = state.colliders[:, number].astype(np.float64)
        if body.kind == "plane":
            gap = dot(ends[:, 1][:, :, None], x - ends[:, 0][:, :, None])
        else:
            gap = np.linalg.norm(x - on_axis(ends, axis_parameter(ends, x)), axis=1, keepdims=True) - body.radius
        deepest = np.maximum(deepest, keep - gap[:, 0])
    return deepest


def penetration(scene: Scene, state: State, *, thickness: float | None = None, tolerance: float = 1e-6) -> Penetration:
    """Statistics of ``depths`` beyond ``tolerance`` [m] (float32 rounds positions to 1e-7 m); handles don't count."""
    depth = depths(scene, state, thickness=thickness)
    depth[:, list(scene.handles)] = -np.inf
    inside = depth > tolerance
    count, found = inside.sum(1), np.where(inside, depth, 0.0)
    return Penetration(found.sum(1) / np.maximum(count, 1), found.max(1), count)
