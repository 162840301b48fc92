"""The layout of a rollout file: names, attributes and empty datasets."""

import json
from dataclasses import asdict

import h5py
import numpy as np

from cloth_envs.grid import Grid
from cloth_envs.material import PROPERTIES, Material
from cloth_envs.particles import Particles
from cloth_envs.scene import Collider, Scene, Wind
from cloth_envs.version import __version__

LAYOUT_VERSION = 2
SMALL_CHUNK = 64  # frames, or trajectories, of everything but the cloth
UNITS = "SI: m, s, kg, Pa; z up"
# State's field -> where its frames are kept; positions and velocities also change their order of axes.
PATHS = {
    "positions": "t1_fields/positions",
    "velocities": "t1_fields/velocities",
    "colliders": "colliders/positions",
    "collider_velocities": "colliders/velocities",
    "wind": "wind",
    "pressure": "scalars/pressure",
    "time": "dimensions/time",
}


def scene_from_json(text: str, handles: tuple[int, ...]) -> Scene:
    """The scene that ``lay_out`` wrote; needs no registry, so scenes of other packages load too."""
    parts = json.loads(text)
    parts["grid"], parts["material"] = Grid(**parts["grid"]), Material(**parts["material"])
    parts["wind"] = parts["wind"] and Wind(**parts["wind"])
    net = parts.get("particles")  # files of version 0.1 have none
    parts["particles"] = net and Particles(**net)
    parts["colliders"] = tuple(Collider(**body) for body in parts["colliders"])
    return Scene(**parts, handles=handles)


def lay_out(file: h5py.File, scene: Scene, *, dtype: np.dtype, chunk: int, actions: int, env_spec: str) -> None:
    """Create everything in an empty file, with no trajectories yet; ``dtype`` is the cloth's, ``chunk`` is in frames.

    Nothing can be added later, in HDF5's single-writer mode.
    """
    grid, bodies = scene.grid, len(scene.colliders)
    file.attrs.update(
        layout_version=LAYOUT_VERSION,
        scene=json.dumps({name: value for name, value in asdict(scene).items() if name != "handles"}),
        env_spec=env_spec,
        package_version=__version__,
        units=UNITS,
        dataset_name=f"minicloth_{scene.name}",
        grid_type="cartesian",
        n_spatial_dims=2,
        n_trajectories=0,
        simulation_parameters=_texts([]),
    )
    cloth, body = (*grid.shape, 3), (bodies, 2, 3)
    shapes: dict[str, tuple[int, ...]] = {"t1_fields/positions": cloth, "t1_fields/velocities": cloth}
    shapes |= {"colliders/positions": body, "colliders/velocities": body, "wind": (3,), "actions": (actions,)}
    shapes |= {"scalars/pressure": (), "scalars/reward": (), "dimensions/time": ()}
    for path, shape in shapes.items():
        if 0 in shape:
            continue
        frames = chunk if shape == cloth else SMALL_CHUNK
        dataset = file.create_dataset(
            path,
            (0, 0, *shape),
            dtype if shape in (cloth, body) else np.float64,
            maxshape=(None, None, *shape),
            chunks=(1, frames, *shape),
            fillvalue=np.nan,
        )
        dataset.attrs.update(sample_varying=True, time_varying=True)
        if shape == cloth:
            dataset.attrs["dim_varying"] = np.array([True, True])
    whole = {"seeds": (np.int64, -1), "frames": (np.int64, 0)}  # one value a trajectory
    for path, (kind, fill) in {**{f"scalars/{name}": (np.float64, np.nan) for name in PROPERTIES}, **whole}.items():
        dataset = file.create_dataset(path, (0,), kind, maxshape=(None,), chunks=(SMALL_CHUNK,), fillvalue=fill)
        dataset.attrs.update(sample_varying=True, time_varying=False)
    names = {"t0_fields": [], "t1_fields": ["positions", "velocities"], "t2_fields": []}
    for group, members in {**names, "scalars": ["reward", "pressure", *PROPERTIES]}.items():
        file.require_group(group).attrs["field_names"] = _texts(members)
    dimensions = file["dimensions"]
    dimensions.attrs["spatial_dims"] = _texts(["row", "col"])
    for name, count, spacing in (("row", grid.rows, grid.row_spacing), ("col", grid.cols, grid.col_spacing)):
        dimensions[name] = (np.arange(count) * spacing).astype(np.float32)
        dimensions[name].attrs.update(sample_varying=False, time_varying=False)
    held = np.zeros(grid.shape, bool)
    held.flat[list(scene.handles)] = True
    _boundary(file, "handles", "wall", ["row", "col"], held)["vertices"] = np.array(scene.handles, np.int64)
    if grid.periodic:
        _boundary(file, "closed", "periodic", ["col"], np.isin(np.arange(grid.cols), (0, grid.cols - 1)))


def _texts(values: list[str]) -> np.ndarray:
    return np.array(values, h5py.string_dtype())


def _boundary(file: h5py.File, name: str, kind: str, dims: list[str], mask: np.ndarray) -> h5py.Group:
    boundary = file.create_group(f"boundary_conditions/{name}")
    boundary["mask"] = mask
    boundary.attrs.update(bc_type=kind, sample_varying=False, time_varying=False)
    boundary.attrs.update(associated_dims=_texts(dims), associated_fields=_texts([]))
    return boundary
