"""What a card is told of sheets: the structures of ``kernels/gpu/terms.hpp``."""

from collections.abc import Sequence

import numpy as np

from cloth_envs.material import Material
from cloth_envs.physics.explicit.bounds import LEVELS, parting
from cloth_envs.physics.explicit.cuts import FrameCuts
from cloth_envs.physics.solver import PRESSURE, air_bound, fastest, pressure_bound
from cloth_envs.scene import Scene

SHEET = np.dtype(
    [(name, np.int32) for name in ("rows", "cols", "periodic", "handles", "soft")]
    + [(name, np.int32) for name in ("bodies", "air", "pressure", "bends", "spare")]
    + [(name, np.float64) for name in ("row_length", "col_length", "diagonal", "frame_dt", "gravity")]
    + [(name, np.float64) for name in ("air_normal", "air_lift", "air_tangential")]
    + [(name, np.float64) for name in ("fastest", "max_wind", "usual_pressure", "sheared", "most_sheared")]
)
BODY = np.dtype([("radius", np.float64), ("friction", np.float64), ("plane", np.int32)], align=True)
CLOTH = np.dtype(
    [(name, np.float32) for name in ("stretch", "shear", "damping", "bend", "twist")]
    + [(name, np.float32) for name in ("yields", "buckled", "buckling", "shortened_damping")]
    + [(name, np.float32) for name in ("density", "drag", "parting", "air", "push")]
    + [("simple", np.int32), ("cuts", np.int32, (len(LEVELS), 2))]
)


def sheet_of(scene: Scene, *, bends: bool) -> np.ndarray:
    """What all cloths of ``scene`` share, an array of one ``SHEET``; ``bends``: whether any of them resists bending."""
    grid, air = scene.grid, scene.air
    wind = air.max_wind if air else 0.0
    coefficients = [air.density * c for c in (air.normal, air.lift, air.tangential)] if air else [0.0] * 3
    handles = (len(scene.handles), not scene.holding.firm.all())
    terms = (len(scene.colliders), air is not None, scene.pressure, bends, 0)
    lengths = (grid.row_spacing, grid.col_spacing, grid.diagonal, scene.frame_dt, scene.gravity)
    limits = (fastest(scene), wind, PRESSURE, LEVELS[0][2], LEVELS[1][2])
    return np.array([(*grid.shape, grid.periodic, *handles, *terms, *lengths, *coefficients, *limits)], SHEET)


def bodies_of(scene: Scene) -> np.ndarray:
    """The bodies, an array of ``BODY``."""
    return np.array([(b.radius + scene.thickness, b.friction, b.kind == "plane") for b in scene.colliders], BODY)


def cloths_of(scene: Scene, cutter: FrameCuts, materials: Sequence[Material]) -> np.ndarray:
    """Cloths of some materials, an array of ``CLOTH``. Raises ValueError: one that can't be stepped."""
    number = {m: k for k, m in enumerate(dict.fromkeys(materials))}
    return np.array([_cloth(scene, cutter, m) for m in number], CLOTH)[[number[m] for m in materials]]


def _cloth(scene: Scene, cutter: FrameCuts, m: Material) -> tuple[object, ...]:
    cuts, c, q = cutter(m), m.compression, m.post_buckling
    springs = (m.stretch_stiffness, m.shear_stiffness, m.damping, m.bend_stiffness, m.twist)
    yielding = (c * q - 1, c - c * q, m.buckling_strain, m.compression_damping)
    rates = (air_bound(scene, m) / fastest(scene), pressure_bound(scene, m, 1.0))
    apart = parting(scene, m, scene.frame_dt / cuts[0][0])
    return (*springs, *yielding, m.areal_density, m.drag, apart, *rates, m.simple, cuts)


def as_literal(sheet: np.ndarray) -> str:
    """One structure as C++ writes it, without the braces of arrays in it."""
    values = (number for value in sheet[0].item() for number in np.ravel(value).tolist())
    return "{" + ", ".join(map(repr, values)) + "}"
