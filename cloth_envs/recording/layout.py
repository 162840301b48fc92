"""The layout of a rollout file: names, attributes and empty datasets."""

import json
from collections.abc import Mapping
from dataclasses import asdict, is_dataclass
from typing import Any

import h5py
import numpy as np

from cloth_envs.grid import Grid
from cloth_envs.grip import Grip
from cloth_envs.material import PROPERTIES, Material
from cloth_envs.particles import Particles
from cloth_envs.scene import Air, Collider, Scene, SelfContact
from cloth_envs.version import __version__

LAYOUT_VERSION = 3
SMALL_CHUNK = 64  # frames, or trajectories, of everything but the cloth
# State's cloth -> where the three components of its frames are kept; and the rest of it.
CLOTH = {
    "positions": tuple(f"t0_fields/position_{axis}" for axis in "xyz"),
    "velocities": tuple(f"t0_fields/velocity_{axis}" for axis in "xyz"),
}
PATHS = {
    "colliders": "colliders/positions",
    "collider_velocities": "colliders/velocities",
    "wind": "wind",
    "pressure": "scalars/pressure",
    "time": "dimensions/time",
}
UNITS = {
    **dict.fromkeys((*CLOTH["positions"], "colliders/positions", "dimensions/row", "dimensions/col"), "m"),
    **dict.fromkeys((*CLOTH["velocities"], "colliders/velocities", "wind"), "m/s"),
    "scalars/pressure": "Pa",
    "dimensions/time": "s",
    "scalars/areal_density": "kg/m^2",
    "scalars/stretch_stiffness": "N/m",
    "scalars/shear_stiffness": "N/m",
    "scalars/bend_stiffness": "N m",
    "scalars/damping": "s",
    "scalars/drag": "1/s",
}  # all others are pure numbers, "1"
PACKED: dict[str, Any] = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
RESET, SEEDED = 1, 2  # how a trajectory began: by a reset, and one with a seed; 0: by a change of the state


def scene_from_json(text: str, handles: tuple[int, ...] | None = None) -> Scene:
    """The scene that ``lay_out`` wrote; needs no registry, so scenes of other packages load too.

    ``handles`` are those of layouts 1 and 2, which kept them elsewhere.
    """
    parts = json.loads(text)
    if "wind" in parts:  # older files: air was wind without lift, drag could be off, nothing resisted twist
        wind, drag = parts.pop("wind"), parts.pop("drag")
        parts["air"] = wind and {
            "density": wind["air_density"], "normal": wind["normal"], "lift": 0.0,
            "tangential": wind["tangential"], "max_wind": wind["max_speed"],
        }  # fmt: skip
        parts["material"] |= {"twist": 0.0} | ({} if drag else {"drag": 0.0})
    parts["grid"], parts["material"] = Grid(**parts["grid"]), Material(**parts["material"])
    parts["air"] = parts["air"] and Air(**parts["air"])
    net = parts.get("particles")  # files of version 0.1 have none
    parts["particles"] = net and Particles(**net)
    own = parts.get("self_contact")  # older files have none
    parts["self_contact"] = own and SelfContact(**own)
    parts["colliders"] = tuple(Collider(**body) for body in parts["colliders"])
    parts["handles"] = tuple(parts["handles"]) if handles is None else handles
    grips = parts.get("grips", ())  # files of version 0.1 have none
    parts["grips"] = tuple(Grip(tuple(g["middle"]), g["radius"], tuple(g["along"])) for g in grips)
    return Scene(**parts)


def plain(value: Any) -> Any:
    """NumPy's numbers and arrays, and dataclasses, as JSON has them. Raises TypeError: anything else."""
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    if is_dataclass(value) and not isinstance(value, type):
        return asdict(value)
    raise TypeError(f"{type(value).__name__} has no place in JSON")


def lay_out(
    file: h5py.File,
    scene: Scene,
    *,
    dtype: np.dtype,
    chunk: int,
    actions: int,
    about: Mapping[str, str],
    steps: tuple[float, float] | None = None,
) -> None:
    """Create everything in an empty file, with no trajectories yet; ``dtype`` is the cloth's, ``chunk`` is in frames.

    ``about`` are further attributes, as text. With ``steps``, to which the cloth is rounded, it is compressed.
    """
    grid, bodies = scene.grid, len(scene.colliders)
    own: dict[str, Any] = {
        "layout_version": LAYOUT_VERSION,
        "scene": json.dumps(asdict(scene), default=plain),
        **about,
        "package_version": __version__,
        "units": "SI: m, s, kg, Pa; z up",
        "dataset_name": f"minicloth_{scene.name}",
        "grid_type": "cartesian",
        "n_spatial_dims": 2,
        "dt": scene.frame_dt,
        "simulation_parameters": _texts(["dt"]),
    }
    file.attrs.update(own, n_trajectories=0)
    file.create_dataset("commits", data=np.int64(0)).attrs["units"] = "1"
    cloth, body = grid.shape, (bodies, 2, 3)
    shapes: dict[str, tuple[int, ...]] = {path: cloth for paths in CLOTH.values() for path in paths}
    shapes |= {"colliders/positions": body, "colliders/velocities": body, "wind": (3,), "actions": (actions,)}
    shapes |= {"scalars/pressure": (), "scalars/reward": (), "dimensions/time": ()}
    for path, shape in shapes.items():
        if 0 not in shape:
            kind = dtype if shape in (cloth, body) else np.float64
            packed = PACKED if steps and shape == cloth else {}
            _growing(file, path, (chunk if shape == cloth else SMALL_CHUNK, *shape), kind, np.nan, time=True, **packed)
    for paths, step in zip(CLOTH.values(), steps or (), strict=False):
        for path in paths:
            file[path].attrs["rounded_to"] = step
    for name in PROPERTIES:
        _growing(file, f"scalars/{name}", (), np.float64, np.nan)
    _growing(file, "seeds", (1,), np.uint64, 0)
    _growing(file, "began", (), np.uint8, 0)
    _growing(file, "frames", (), np.int64, 0)
    fields = [path.split("/")[1] for paths in CLOTH.values() for path in paths]
    for path in fields:
        file[f"t0_fields/{path}"].attrs["dim_varying"] = np.array([True, True])
    groups = {"t0_fields": fields, "t1_fields": [], "t2_fields": [], "scalars": ["reward", "pressure", *PROPERTIES]}
    for group, members in groups.items():
        file.require_group(group).attrs["field_names"] = _texts(members)
    file.create_group("starts")
    file["dimensions"].attrs["spatial_dims"] = _texts(["row", "col"])
    for name, count, spacing in (("row", grid.rows, grid.row_spacing), ("col", grid.cols, grid.col_spacing)):
        _fixed(file, f"dimensions/{name}", (np.arange(count) * spacing).astype(np.float32))
    held = np.zeros(grid.shape, bool)
    held.flat[list(scene.handles)] = True
    _boundary(file, "handles", "wall", ["row", "col"], held)
    _fixed(file, "boundary_conditions/handles/vertices", np.array(scene.handles, np.int64))
    if grid.periodic:
        _boundary(file, "closed", "periodic", ["col"], np.isin(np.arange(grid.cols), (0, grid.cols - 1)))


def _texts(values: list[str]) -> np.ndarray:
    return np.array(values, h5py.string_dtype())


def _growing(
    file: h5py.File, path: str, chunk: tuple[int, ...], kind: Any, fill: float, *, time: bool = False, **packed: Any
) -> None:
    """A dataset of no trajectories; ``chunk`` is the shape that is kept together of one of them, in ``time`` or not."""
    chunks = (1, *chunk) if time else (SMALL_CHUNK, *chunk)
    empty = (0, 0, *chunk[1:]) if time else (0, *chunk)
    most = (None, None, *chunk[1:]) if time else (None,) * (1 + len(chunk))
    dataset = file.create_dataset(
        path, empty, kind, maxshape=most, chunks=chunks, fillvalue=fill, fletcher32=True, **packed
    )
    dataset.attrs.update(units=UNITS.get(path, "1"), sample_varying=True, time_varying=time)


def _fixed(file: h5py.File, path: str, values: np.ndarray) -> None:
    dataset = file.create_dataset(path, data=values)
    dataset.attrs.update(units=UNITS.get(path, "1"), sample_varying=False, time_varying=False)


def _boundary(file: h5py.File, name: str, kind: str, dims: list[str], mask: np.ndarray) -> None:
    boundary = file.create_group(f"boundary_conditions/{name}")
    _fixed(file, f"boundary_conditions/{name}/mask", mask)
    boundary.attrs.update(bc_type=kind, sample_varying=False, time_varying=False)
    boundary.attrs.update(associated_dims=_texts(dims), associated_fields=_texts([]))
