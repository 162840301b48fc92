"""What exports leave on the disk: a whole file or series, or what was there before; and what they refuse."""

import json
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import pyvista

from cloth_envs.commands.cli import main
from cloth_envs.export import export
from cloth_envs.export.series import Series
from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.recording import RolloutWriter
from cloth_envs.scene import Collider, Scene
from cloth_envs.state import State

FRAMES = 6
OUTPUTS = {"vtk": "x.pvd", "gltf": "x.glb", "ply": "x", "usda": "x.usda", "usdc": "x.usdc"}  # by the words of ids
LIMITED = """
import resource, sys
from cloth_envs.export import export
source, format, *outs = sys.argv[1:]
for limit in (1500, 100):
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    for out in outs:
        try:
            export(source, format=format, out=out)
        except OSError as error:
            print(error)
"""


def record(path: Path, change: str = "", value: float = 0.0, times: list[float] | None = None) -> Path:
    """A sphere beside a cloth at random; at frame 4 a number of the field ``change`` is ``value``."""
    scene = Scene("One body", Grid(4, 5, 0.6, 0.8), Material(), 0.04, colliders=(Collider("sphere", 0.2),))
    generator = np.random.default_rng(0)
    with RolloutWriter(path, scene) as writer:
        writer.begin()
        for frame in range(FRAMES):
            state = State.still(generator.normal(size=(1, 3, 4, 5)).astype(np.float32), np.zeros((1, 1, 2, 3)))
            if frame == 4 and change:
                getattr(state, change)[(0,) * getattr(state, change).ndim] = value
            state.time[:] = frame * scene.frame_dt if times is None else times[frame]
            writer.append(state)
    return path


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("recording") / "a.h5")


@pytest.fixture(params=OUTPUTS)
def output(request: pytest.FixtureRequest) -> tuple[str, str]:
    """A format and the name of its output."""
    if request.param.startswith("usd"):
        pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    return request.param[:3] if request.param.startswith("usd") else request.param, OUTPUTS[request.param]


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def times(format: str, path: Path) -> list[float]:
    """The times [s] of an export's frames."""
    if format == "vtk":
        return list(pyvista.get_reader(path).time_values)
    if format == "ply":
        files = sorted(path.glob("cloth_*.ply"))
        return [float(file.read_bytes().split(b"comment time ")[1].split(b" ")[0]) for file in files]
    if format == "usd":
        from pxr import Usd, UsdGeom

        stage = Usd.Stage.Open(str(path))
        codes = UsdGeom.Mesh(stage.GetDefaultPrim().GetChild("cloth")).GetPointsAttr().GetTimeSamples()
        return [code / stage.GetTimeCodesPerSecond() for code in codes]
    data = path.read_bytes()
    (size,) = struct.unpack_from("<I", data, 12)
    content = json.loads(data[20 : 20 + size], parse_constant=pytest.fail)
    accessor = content["accessors"][content["animations"][0]["samplers"][0]["input"]]
    start = 28 + size + content["bufferViews"][accessor["bufferView"]]["byteOffset"]
    return np.frombuffer(data, "<f4", accessor["count"], start).tolist()


@pytest.mark.skipif(sys.platform == "win32", reason="no RLIMIT_FSIZE")
def test_a_full_disk_keeps_what_was_there(output: tuple[str, str], recording: Path, tmp_path: Path) -> None:
    format, name = output
    old, new = tmp_path / name, tmp_path / "new" / name
    new.parent.mkdir()
    export(recording, format=format, out=old, every=2)
    before = contents(tmp_path)
    words = [sys.executable, "-c", LIMITED, str(recording), format, str(old), str(new)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for line, out in zip(done.stdout.splitlines(), [old, new] * 2, strict=True):
        assert line.startswith(f"can't write {out.with_suffix('')}")  # the file, or one in its folder
        assert line.endswith("(File too large): free some space, or choose a path on another disk")
    assert contents(tmp_path) == before
    assert not list(new.parent.iterdir())


def test_a_file_that_does_not_read_back_is_an_error(recording: Path, tmp_path: Path) -> None:
    pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    from pxr import Sdf

    def cut(layer: Sdf.Layer, path: str) -> bool:
        meant, less = Sdf.Layer.CreateAnonymous(".usda"), layer.ExportToString().replace("4: [", "3.5: [")
        meant.ImportFromString(less)
        return export_layer(meant, path)

    (tmp_path / "x.usdc").write_text("old")
    export_layer = Sdf.Layer.Export
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Sdf.Layer, "Export", cut)
        with pytest.raises(OSError, match=r"can't write .*x\.usdc \(it does not read back as it was written\)"):
            export(recording, format="usd", out=tmp_path / "x.usdc")
    assert contents(tmp_path) == {"x.usdc": b"old"}


def test_an_interrupted_export_keeps_what_was_there(
    output: tuple[str, str], recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    format, name = output
    export(recording, format=format, out=tmp_path / name, every=2)
    before, whole = contents(tmp_path), Series._frame

    def interrupted(self: Series, number: int, *rest: object) -> object:
        if number == 3:
            raise KeyboardInterrupt
        return whole(self, number, *rest)

    monkeypatch.setattr(Series, "_frame", interrupted)
    with pytest.raises(KeyboardInterrupt):
        export(recording, format=format, out=tmp_path / name)
    assert contents(tmp_path) == before


@pytest.mark.parametrize(("format", "name"), [("vtk", "x.pvd"), ("ply", "x")])
def test_a_shorter_series_takes_the_place_of_a_longer(format: str, name: str, recording: Path, tmp_path: Path) -> None:
    export(recording, format=format, out=tmp_path / name)
    others = {"x/notes.txt": "mine", "x/cloth_final.ply": "mine", "x/cloth_00001.obj": "mine"}
    for path, text in others.items():
        (tmp_path / path).write_text(text)
    export(recording, format=format, out=tmp_path / name, every=4)
    suffix = {"vtk": "vtp", "ply": "ply"}[format]
    frames = [f"x/{what}_0000{frame}.{suffix}" for what in ("bodies", "cloth") for frame in (0, 4)]
    assert sorted(contents(tmp_path)) == sorted([*others, *frames, *(["x.pvd"] if format == "vtk" else [])])


@pytest.mark.parametrize(("format", "name"), [("vtk", "x.pvd"), ("ply", "x")])
def test_a_file_in_the_folders_place_stays(format: str, name: str, recording: Path, tmp_path: Path) -> None:
    (tmp_path / "x").write_text("mine")
    with pytest.raises(OSError, match=r"^can't write frames into the folder .*x, which is a file: move that away"):
        export(recording, format=format, out=tmp_path / name)
    assert contents(tmp_path) == {"x": b"mine"}


@pytest.mark.parametrize("field", ["positions", "velocities", "colliders"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -3e38])
def test_what_is_not_finite_is_refused(field: str, value: float, output: tuple[str, str], tmp_path: Path) -> None:
    path = record(tmp_path / "a.h5", field, value)
    with pytest.raises(ValueError, match=f"frame 4 of trajectory 0 has {field} that are not finite"):
        export(path, format=output[0], out=tmp_path / output[1])
    assert list(contents(tmp_path)) == ["a.h5"]
    export(path, format=output[0], out=tmp_path / output[1], every=3)  # frames 0 and 3


BAD_TIMES = {
    "all 0": [0.0] * FRAMES,
    "backwards": [0.2, 0.16, 0.12, 0.08, 0.04, 0.0],
    "twice": [0.0, 0.04, 0.04, 0.08, 0.12, 0.16],
    "negative": [-0.04, 0.0, 0.04, 0.08, 0.12, 0.16],
    "not finite": [0.0, np.nan, 0.08, 0.12, 0.16, 0.2],
    "endless": [0.0, 0.04, 0.08, 0.12, 0.16, np.inf],
    "endless twice": [0.0, 0.04, 0.08, 0.12, np.inf, np.inf],
    "the same in float32": [1e7 + 0.04 * frame for frame in range(FRAMES)],
}


@pytest.mark.parametrize("told", BAD_TIMES.values(), ids=BAD_TIMES)
def test_times_that_do_not_increase_are_those_of_the_frames(
    told: list[float], output: tuple[str, str], tmp_path: Path
) -> None:
    path = export(record(tmp_path / "a.h5", times=told), format=output[0], out=tmp_path / output[1])
    np.testing.assert_allclose(times(output[0], path), [0.04 * frame for frame in range(FRAMES)], rtol=1e-6)


def test_times_that_increase_stay(output: tuple[str, str], tmp_path: Path) -> None:
    told = [1.0, 1.04, 1.1, 1.2, 1.24, 1.28]
    path = export(record(tmp_path / "a.h5", times=told), format=output[0], out=tmp_path / output[1])
    np.testing.assert_allclose(times(output[0], path), told, rtol=1e-6)


def test_more_than_gltf_can_hold_is_refused(recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "x.glb").write_text("old")
    monkeypatch.setattr(Series, "__len__", lambda self: 40_000)  # weights of 6.4 GB
    with pytest.raises(ValueError, match=r"40000 frames of 20 vertices are 6\.\d GiB in glTF, which holds 4"):
        export(recording, format="gltf", out=tmp_path / "x.glb")
    assert contents(tmp_path) == {"x.glb": b"old"}


def test_the_command_tells_what_it_does_in_a_pipe(
    output: tuple[str, str], recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = str(tmp_path / output[1])
    assert main(["export", str(recording), "--format", output[0], "--out", out]) == 0
    told = capsys.readouterr()
    assert told.out == f"wrote {out}\n"
    plan, done = told.err.splitlines()
    assert plan == f"{recording}: 6 frames of One body, 4 x 5 vertices, as {output[0]} into {out}"
    assert done.startswith("export: 6 of 6 frames, ")


def test_usd_has_the_strain(recording: Path, tmp_path: Path) -> None:
    usd = pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    from pxr import UsdGeom

    stage = usd.Stage.Open(str(export(recording, format="usd", out=tmp_path / "x.usdc")))
    cloth = stage.GetDefaultPrim().GetChild("cloth")
    strain = UsdGeom.PrimvarsAPI(cloth).GetPrimvar("strain")
    assert strain.GetInterpolation() == "vertex"
    folder = export(recording, format="vtk", out=tmp_path / "x.pvd").with_suffix("")
    for frame in range(FRAMES):
        meant = pyvista.read(folder / f"cloth_{frame:05d}.vtp")["strain"]
        np.testing.assert_array_equal(np.array(strain.Get(frame)), meant)
