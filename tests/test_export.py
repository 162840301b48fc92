"""Exported trajectories, read back: vertices, triangles, times and bodies are the recording's."""

import json
import struct
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import pyvista
from scipy.spatial.transform import Rotation

from cloth_envs.commands.cli import main
from cloth_envs.export import export
from cloth_envs.export.bodies import make, place, turn_from_z
from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.recording import RecordRollout, Rollout, RolloutWriter
from cloth_envs.scene import Collider, Scene
from cloth_envs.state import State

FRAMES = 4
BODIES = (Collider("sphere", 0.2, name="ball"), Collider("capsule", 0.1, name="a limb"), Collider("plane"))


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two trajectories of a cloth beside a sphere, a capsule that turns and a plane; the second is empty."""
    path = tmp_path_factory.mktemp("recording") / "three.h5"
    scene = Scene("Three bodies", Grid(4, 5, 0.6, 0.8), Material(), 0.04, colliders=BODIES)
    generator = np.random.default_rng(0)
    with RolloutWriter(path, scene) as writer:
        writer.begin(0)
        for frame in range(FRAMES):
            state = State.still(generator.normal(size=(1, 3, 4, 5)).astype(np.float32), np.zeros((1, 3, 2, 3)))
            state.velocities[:] = generator.normal(size=state.velocities.shape)
            turn = np.array([np.sin(0.7 * frame), 0.0, np.cos(0.7 * frame)])
            state.colliders[0, 0] = [0.1 * frame, 0.0, 0.5]
            state.colliders[0, 1] = np.array([0.0, 0.1 * frame, 1.0]) + 0.15 * np.stack([-turn, turn])
            state.colliders[0, 2] = [0, 0, -0.1], [0, 0, 1]
            state.time[:] = frame * scene.frame_dt
            writer.append(state)
    return path


@pytest.fixture
def states(recording: Path) -> list[State]:
    with Rollout.open(recording) as rollout:
        return list(rollout.states())


def vertices(state: State) -> np.ndarray:
    return state.positions[0].reshape(3, -1).T


def gltf(path: Path) -> tuple[dict, list[np.ndarray]]:
    """The JSON of a binary glTF file and its accessors' values."""
    data = path.read_bytes()
    magic, version, length, size, kind = struct.unpack_from("<4sIII4s", data)
    assert (magic, version, length, kind) == (b"glTF", 2, len(data), b"JSON")
    content = json.loads(data[20 : 20 + size])
    assert struct.unpack_from("<I4s", data, 20 + size) == (content["buffers"][0]["byteLength"], b"BIN\0")
    arrays = []
    for accessor in content["accessors"]:
        view = content["bufferViews"][accessor["bufferView"]]
        columns = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        kind = {5126: "<f4", 5125: "<u4"}[accessor["componentType"]]
        start = 28 + size + view["byteOffset"]
        values = np.frombuffer(data, kind, accessor["count"] * columns, start).reshape(-1, columns)
        np.testing.assert_array_equal(values.min(0), np.array(accessor["min"], kind))
        np.testing.assert_array_equal(values.max(0), np.array(accessor["max"], kind))
        arrays.append(values)
    return content, arrays


def test_vtk_collection_has_every_frame(recording: Path, states: list[State], tmp_path: Path) -> None:
    reader = pyvista.get_reader(export(recording, format="vtk", out=tmp_path / "x.pvd"))
    np.testing.assert_allclose(reader.time_values, [0.04 * frame for frame in range(FRAMES)])
    for frame, state in enumerate(states):
        reader.set_active_time_point(frame)
        cloth, bodies = reader.read()
        np.testing.assert_array_equal(cloth.points, vertices(state))
        np.testing.assert_array_equal(cloth["velocity"], state.velocities[0].reshape(3, -1).T)
        assert cloth.n_cells == 2 * 3 * 4
        assert cloth.active_texture_coordinates.shape == (20, 2)
        assert "strain" in cloth.point_data
        ball = bodies.points[bodies["body"] == 0]
        np.testing.assert_allclose(np.linalg.norm(ball - [0.1 * frame, 0, 0.5], axis=1), 0.2, atol=1e-6)
        limb = bodies.points[bodies["body"] == 1]
        first, second = state.colliders[0, 1]
        share = np.clip((limb - first) @ (second - first) / 0.3**2, 0, 1)[:, None]
        np.testing.assert_allclose(np.linalg.norm(limb - first - share * (second - first), axis=1), 0.1, atol=1e-6)
        np.testing.assert_allclose(bodies.points[bodies["body"] == 2][:, 2], -0.1, atol=1e-6)


def test_gltf_morphs_through_every_frame(recording: Path, states: list[State], tmp_path: Path) -> None:
    content, arrays = gltf(export(recording, format="gltf", out=tmp_path / "x.glb"))
    cloth = content["meshes"][content["nodes"][0]["mesh"]]["primitives"][0]
    assert len(arrays[cloth["indices"]]) == 3 * 2 * 3 * 4
    assert len(cloth["targets"]) == FRAMES - 1
    first = arrays[cloth["attributes"]["POSITION"]]
    animation = content["animations"][0]
    moves = {
        (c["target"]["node"], c["target"]["path"]): arrays[animation["samplers"][c["sampler"]]["output"]]
        for c in animation["channels"]
    }
    times = arrays[animation["samplers"][0]["input"]].ravel()
    np.testing.assert_allclose(times, [s.time[0] for s in states], rtol=1e-6)
    weights = moves[0, "weights"].reshape(FRAMES, FRAMES - 1)
    for frame, state in enumerate(states):
        shown = first + sum(
            weight * arrays[target["POSITION"]] for weight, target in zip(weights[frame], cloth["targets"], strict=True)
        )
        np.testing.assert_allclose(shown, vertices(state), atol=1e-6)
        np.testing.assert_allclose(moves[1, "translation"][frame], state.colliders[0, 0, 0], atol=1e-7)
        axis = state.colliders[0, 1, 1] - state.colliders[0, 1, 0]
        turned = Rotation.from_quat(moves[2, "rotation"][frame]).apply([0, 0, 0.3])
        np.testing.assert_allclose(turned, axis, atol=1e-6)
    root = content["nodes"][content["scenes"][0]["nodes"][0]]
    np.testing.assert_allclose(Rotation.from_quat(root["rotation"]).apply([0, 0, 1]), [0, 1, 0], atol=1e-12)
    assert root["children"] == [0, 1, 2, 3]


def test_vtk_opens_the_gltf(recording: Path, states: list[State], tmp_path: Path) -> None:
    blocks = pyvista.get_reader(export(recording, format="gltf", out=tmp_path / "x.glb")).read()
    cloth = next(block for block in blocks.recursive_iterator() if block.n_points == 20)
    x, y, z = vertices(states[0]).T
    np.testing.assert_allclose(cloth.points, np.stack([x, z, -y], 1), atol=1e-6)


def test_ply_has_a_file_a_frame(recording: Path, states: list[State], tmp_path: Path) -> None:
    folder = export(recording, format="ply", out=tmp_path / "plys")
    names = sorted(path.name for path in folder.iterdir())
    assert names == [f"{what}_{frame:05d}.ply" for what in ("bodies", "cloth") for frame in range(FRAMES)]
    for frame, state in enumerate(states):
        cloth = pyvista.read(folder / f"cloth_{frame:05d}.ply")
        np.testing.assert_array_equal(cloth.points, vertices(state))
        assert cloth.n_cells == 24
        assert pyvista.read(folder / f"bodies_{frame:05d}.ply").n_cells > 1000


def test_usd_has_time_samples(recording: Path, states: list[State], tmp_path: Path) -> None:
    usd = pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    from pxr import UsdGeom

    stage = usd.Stage.Open(str(export(recording, format="usd", out=tmp_path / "x.usda")))
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert stage.GetTimeCodesPerSecond() == 25
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0, FRAMES - 1)
    root = stage.GetDefaultPrim()
    cloth = UsdGeom.Mesh(root.GetChild("cloth"))
    assert cloth.GetPointsAttr().GetTimeSamples() == list(range(FRAMES))
    assert len(cloth.GetFaceVertexCountsAttr().Get()) == 24
    assert len(UsdGeom.PrimvarsAPI(cloth).GetPrimvar("st").Get()) == 20
    sphere, capsule, plane = (root.GetChild(name) for name in ("ball_0", "a_limb_1", "body_2"))
    assert [p.GetTypeName() for p in (sphere, capsule, plane)] == ["Sphere", "Capsule", "Plane"]
    for frame, state in enumerate(states):
        np.testing.assert_array_equal(cloth.GetPointsAttr().Get(frame), vertices(state))
        matrix = np.array(UsdGeom.Xformable(sphere).ComputeLocalToWorldTransform(frame))
        np.testing.assert_allclose(matrix[3, :3], state.colliders[0, 0, 0])
        matrix = np.array(UsdGeom.Xformable(capsule).ComputeLocalToWorldTransform(frame))
        axis = state.colliders[0, 1, 1] - state.colliders[0, 1, 0]
        np.testing.assert_allclose([0, 0, 0.3] @ matrix[:3, :3], axis, atol=1e-6)


@pytest.mark.parametrize("format", ["vtk", "gltf", "ply", "usd"])
def test_the_command_exports_what_was_recorded(format: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if format == "usd":
        pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    env = RecordRollout(
        gym.make("MiniCloth-BallDrop-v0", resolution=(5, 5), disable_env_checker=True), tmp_path / "a.h5"
    )
    env.reset(seed=0)
    for _ in range(4):
        env.step(np.zeros(2, np.float32))
    env.close()
    assert main(["export", str(tmp_path / "a.h5"), "--format", format, "--every", "2"]) == 0
    written = Path(capsys.readouterr().out.removeprefix("wrote ").strip())
    assert written.exists()
    again = main(["export", str(tmp_path / "a.h5"), "--format", format, "--every", "2", "--out", str(tmp_path / "new")])
    assert again == 0
    if format == "ply":
        assert len(list((tmp_path / "new").glob("cloth_*.ply"))) == 3
    else:
        assert (tmp_path / "new" / written.name).exists()


def test_a_tube_closes(tmp_path: Path) -> None:
    scene = Scene("Tube", Grid(3, 6, 1.0, 1.0, periodic=True), Material(), 0.04)
    turn, down = np.meshgrid(2 * np.pi * np.arange(6) / 6, [0, 0.5, 1])
    with RolloutWriter(tmp_path / "tube.h5", scene) as writer:
        writer.begin()
        writer.append(State.still(np.stack([np.cos(turn), np.sin(turn), -down])[None].astype(np.float32)))
    cloth = pyvista.read(export(tmp_path / "tube.h5", format="ply") / "cloth_00000.ply")
    assert (cloth.n_points, cloth.n_cells) == (3 * 7, 2 * 2 * 6)
    np.testing.assert_array_equal(cloth.points[0], cloth.points[6])


def test_bodies_turn_the_short_way() -> None:
    for axis in np.eye(3).tolist() + (-np.eye(3)).tolist() + [[1.0, 2.0, -3.0]]:
        unit = np.array(axis) / np.linalg.norm(axis)
        np.testing.assert_allclose(Rotation.from_quat(turn_from_z(unit)).apply([0, 0, 1]), unit, atol=1e-12)
    limb = make(0, BODIES[1], 1.0)
    corners = limb.stretched(0.5)[limb.triangles].astype(float)
    assert corners[..., 2].max() == pytest.approx(0.35)
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.einsum("ij,ij->i", outward, corners.mean(1)) > 0).all()
    assert len(limb.points) == 2 + 32 * (2 * 9 - 2)  # poles are a point each, and the equator is there twice
    points, _ = limb.moved(place("capsule", np.array([[1, 0, 0], [1, 0.5, 0]]), np.zeros(3)))
    assert points[:, 1].max() == pytest.approx(0.6)


def test_mistakes_are_told(recording: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"unknown format 'gtlf'\. Did you mean 'gltf'"):
        export(recording, format="gtlf")
    with pytest.raises(ValueError, match="there is no trajectory 3"):
        export(recording, format="ply", trajectory=3)
    with pytest.raises(ValueError, match="every must be at least 1"):
        export(recording, format="ply", every=0)
    with pytest.raises(ValueError, match=r"must end in \.glb"):
        export(recording, format="gltf", out=tmp_path / "x.obj")
    with pytest.raises(FileNotFoundError, match="there is no file"):
        export(tmp_path / "none.h5", format="ply")
    empty = tmp_path / "empty.h5"
    with RolloutWriter(empty, Scene("Empty", Grid(4, 5, 0.6, 0.8), Material(), 0.04)) as writer:
        writer.begin()
    with pytest.raises(ValueError, match="there is no trajectory 0"):
        export(empty, format="ply")
    assert main(["export", str(empty), "--format", "ply"]) == 2


def test_a_missing_package_names_the_extra(recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pxr", None)
    with pytest.raises(ImportError, match=r"usd-core .*\[usd\]"):
        export(recording, format="usd", out=tmp_path / "x.usdc")
    assert not (tmp_path / "x.usdc").exists()
