"""Exported bodies: capsules that grow and turn, planes under a cloth that is far away, normals."""

import json
import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import pyvista
from scipy.spatial.transform import Rotation

from cloth_envs.export import export
from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.recording import RolloutWriter
from cloth_envs.scene import Collider, Scene
from cloth_envs.state import State

FORMATS = ["vtk", "gltf", "ply", "usd"]
LENGTHS = {"from nothing": (0.0, 0.8, 0.3), "shrinks": (0.6, 0.2, 0.0), "rigid": (0.4, 0.4, 0.4)}  # m
RADIUS, FAR = 0.1, np.array([50.0, -20.0, 3.0])
CENTRE = np.array([0.2, 0.0, 0.4])  # of the capsule


def record(path: Path, lengths: tuple[float, ...], normal: Sequence[float] = (0.0, 0.0, 1.0)) -> Path:
    """A cloth that starts at ``FAR`` and falls, with a capsule along x, y, then z and a plane through the origin."""
    bodies = (Collider("capsule", RADIUS, name="limb"), Collider("plane", name="floor"), Collider("sphere", 0.3))
    scene = Scene("Bodies", Grid(3, 3, 0.5, 0.5), Material(), 0.04, colliders=bodies)
    sheet = np.stack([*np.meshgrid([-0.25, 0, 0.25], [0.25, 0, -0.25]), np.zeros((3, 3))])
    with RolloutWriter(path, scene) as writer:
        writer.begin()
        for frame, (length, axis) in enumerate(zip(lengths, np.eye(3), strict=True)):
            at = sheet + (FAR - [0, 0, frame])[:, None, None]
            state = State.still(at[None].astype(np.float32), np.zeros((1, 3, 2, 3)))
            state.colliders[0, 0] = CENTRE + length / 2 * np.stack([-axis, axis])
            state.colliders[0, 1] = (0, 0, 0), normal
            state.colliders[0, 2] = [[0, 0, 1 + frame]] * 2
            state.time[:] = frame * scene.frame_dt
            writer.append(state)
    return path


def gltf(path: Path, frame: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Points and normals of every body at ``frame``, z up: what a player that knows morph targets shows."""
    data = path.read_bytes()
    (size,) = struct.unpack_from("<I", data, 12)
    content = json.loads(data[20 : 20 + size], parse_constant=pytest.fail)

    def array(number: int) -> np.ndarray:
        accessor = content["accessors"][number]
        columns = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        start = 28 + size + content["bufferViews"][accessor["bufferView"]]["byteOffset"]
        return np.frombuffer(data, "<f4", accessor["count"] * columns, start).reshape(-1, columns)

    animation, shown = content["animations"][0], []
    for number, node in enumerate(content["nodes"][1:-1], 1):  # the first is the cloth, the last the root
        moves = {
            channel["target"]["path"]: array(animation["samplers"][channel["sampler"]]["output"])
            for channel in animation["channels"]
            if channel["target"]["node"] == number
        }
        mesh = content["meshes"][node["mesh"]]
        (primitive,) = mesh["primitives"]
        points, normals = (array(primitive["attributes"][name]) for name in ("POSITION", "NORMAL"))
        if "weights" in moves:
            np.testing.assert_allclose(mesh["weights"], moves["weights"][0], atol=1e-6)
            points = points + moves["weights"][frame] * array(primitive["targets"][0]["POSITION"])
        turn = Rotation.from_quat(moves["rotation"][frame])
        shown.append((turn.apply(points) + moves["translation"][frame], turn.apply(normals)))
    return shown


def shown(path: Path, format: str, frame: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Points and normals of every body at ``frame``."""
    if format == "gltf":
        return gltf(path, frame)
    folder = path if format == "ply" else path.with_suffix("")
    mesh = pyvista.read(folder / f"bodies_{frame:05d}.{'ply' if format == 'ply' else 'vtp'}")
    bodies = np.repeat(np.arange(3), [mesh.n_points - 4 - 482, 4, 482])  # capsule, plane, sphere
    assert "Normals" in mesh.point_data
    return [(mesh.points[bodies == body], mesh["Normals"][bodies == body]) for body in range(3)]


@pytest.mark.parametrize("lengths", LENGTHS.values(), ids=LENGTHS)
@pytest.mark.parametrize("format", FORMATS)
def test_a_capsule_is_as_long_as_it_was(format: str, lengths: tuple[float, ...], tmp_path: Path) -> None:
    usd = pytest.importorskip("pxr.Usd", reason="usd-core is not installed") if format == "usd" else None
    path = export(record(tmp_path / "a.h5", lengths), format=format)
    stage = usd and usd.Stage.Open(str(path))
    for frame, (length, axis) in enumerate(zip(lengths, np.eye(3), strict=True)):
        half = RADIUS + length / 2 * axis
        if stage:
            from pxr import UsdGeom

            limb = stage.GetDefaultPrim().GetChild("limb_0")
            assert UsdGeom.Capsule(limb).GetRadiusAttr().Get() == pytest.approx(RADIUS)
            box = UsdGeom.BBoxCache(frame, ["default"]).ComputeWorldBound(limb).ComputeAlignedRange()
            low, high = np.array(box.GetMin()), np.array(box.GetMax())
        else:
            points, normals = shown(path, format, frame)[0]
            low, high = points.min(0), points.max(0)
            nearest = CENTRE + np.clip((points - CENTRE) @ axis, -length / 2, length / 2)[:, None] * axis
            np.testing.assert_allclose((points - nearest) / RADIUS, normals, atol=2e-5)
        np.testing.assert_allclose([low, high], [CENTRE - half, CENTRE + half], atol=1e-5)


@pytest.mark.parametrize("normal", [[0.0, 0.0, 1.0], [0.0, 0.6, 0.8]], ids=["level", "slope"])
@pytest.mark.parametrize("format", FORMATS)
def test_a_plane_is_where_the_cloth_is(format: str, normal: list[float], tmp_path: Path) -> None:
    usd = pytest.importorskip("pxr.Usd", reason="usd-core is not installed") if format == "usd" else None
    path = export(record(tmp_path / "a.h5", (0.0, 0.0, 0.0), normal), format=format)
    stage = usd and usd.Stage.Open(str(path))
    for frame in range(3):
        if stage:
            from pxr import UsdGeom

            floor = UsdGeom.Plane(stage.GetDefaultPrim().GetChild("floor_1"))
            matrix = np.array(UsdGeom.Xformable(floor).ComputeLocalToWorldTransform(frame))
            half = floor.GetWidthAttr().Get() / 2
            square = np.array([[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]])
            points = square @ matrix[:3, :3] + matrix[3, :3]
        else:
            points, normals = shown(path, format, frame)[1]
            np.testing.assert_allclose(normals, [normal] * 4, atol=1e-6)
        np.testing.assert_allclose(points @ normal, 0, atol=1e-4)
        below = FAR - [0, 0, frame] - (FAR - [0, 0, frame]) @ normal * np.array(normal)
        centre, edges = points.mean(0), (points[1] - points[0], points[3] - points[0])
        for edge in edges:  # the cloth's half diagonal, 0.36 m, is inside the square
            assert abs((below - centre) @ edge) / np.linalg.norm(edge) < np.linalg.norm(edge) / 2 - 0.36


@pytest.mark.parametrize("format", ["vtk", "gltf", "ply"])
def test_a_sphere_has_smooth_normals(format: str, tmp_path: Path) -> None:
    path = export(record(tmp_path / "a.h5", (0.1, 0.1, 0.1)), format=format)
    for frame in range(3):
        points, normals = shown(path, format, frame)[2]
        np.testing.assert_allclose((points - [0, 0, 1 + frame]) / 0.3, normals, atol=1e-5)
