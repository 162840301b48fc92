"""Rollout files: what is read is what was simulated, also after a killed writer; errors name the remedy."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import h5py
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec

import cloth_envs
from cloth_envs.grid import Grid
from cloth_envs.recording import RecordRollout, Rollout, RolloutWriter
from cloth_envs.recording.layout import LAYOUT_VERSION
from cloth_envs.scenes.collision import Collision

SMALL = {"resolution": (9, 13)}


def record(path: Path, scene: str, episodes: tuple[int, ...], **options: object) -> list[list[cloth_envs.State]]:
    """Record episodes of the given lengths under seeded random actions; returns all states."""
    env = RecordRollout(gym.make(cloth_envs.env_id(scene), **SMALL, **options), str(path))
    rng, seen = np.random.default_rng(0), []
    for episode, frames in enumerate(episodes):
        env.reset(seed=episode)
        seen.append([env.unwrapped.state.copy()])
        for _ in range(frames):
            env.step(rng.uniform(-1, 1, env.action_space.shape).astype(np.float32))
            seen[-1].append(env.unwrapped.state.copy())
    env.close()
    env.close()
    return seen


@pytest.mark.parametrize("scene", list(cloth_envs.SCENES))
def test_what_is_read_is_what_was_simulated(scene: str, tmp_path: Path) -> None:
    seen = record(tmp_path / "a.h5", scene, (40, 3))
    with Rollout.open(tmp_path / "a.h5") as rollout:
        made = gym.make(cloth_envs.env_id(scene), **SMALL).unwrapped.scene
        assert rollout.scene == made
        assert rollout.lengths == [41, 4]
        assert rollout.seeds == [0, 1]
        for trajectory, states in enumerate(seen):
            for expected, found in zip(states, rollout.states(trajectory), strict=True):
                for name, value in expected.arrays().items():
                    got = getattr(found, name)
                    assert got.dtype == value.dtype
                    np.testing.assert_array_equal(got, value)


def test_actions_and_rewards_lead_to_their_frame(tmp_path: Path) -> None:
    env = RecordRollout(gym.make("MiniCloth-Flag-v0", **SMALL), str(tmp_path / "a.h5"))
    env.reset()
    action = np.float32([0.25, -1.0])
    reward = env.step(action)[1]
    env.close()
    with Rollout.open(tmp_path / "a.h5") as rollout:
        assert rollout.seeds == [None]
        np.testing.assert_array_equal(rollout.actions(), [[0, 0], action])
        np.testing.assert_array_equal(rollout.rewards(), [0, reward])


def test_rounded_cloth_is_as_near_as_its_steps_and_smaller(tmp_path: Path) -> None:
    env = gym.make("MiniCloth-Flag-v0").unwrapped
    env.reset(seed=0)
    steps = {"positions": 2.0**-17, "velocities": 2.0**-10}
    with (
        RolloutWriter(tmp_path / "a.h5", env) as whole,
        RolloutWriter(tmp_path / "b.h5", env, steps=(2**-17, 2**-10)) as b,
    ):
        whole.begin(), b.begin()
        for _ in range(40):
            env.step(env.action_space.sample() * 0)
            whole.append(env.state), b.append(env.state)
    with Rollout.open(tmp_path / "a.h5") as kept, Rollout.open(tmp_path / "b.h5") as rounded:
        for one, other in zip(kept.states(), rounded.states(), strict=True):
            for name, step in steps.items():
                got = getattr(other, name)
                assert abs(got - getattr(one, name)).max() <= step / 2
                assert (got / step % 1 == 0).all()
            np.testing.assert_array_equal(one.time, other.time)
    assert (tmp_path / "b.h5").stat().st_size < 0.5 * (tmp_path / "a.h5").stat().st_size
    with pytest.raises(ValueError, match="leave them out to round nothing"):
        RolloutWriter(tmp_path / "c.h5", env, steps=(0.0, 1.0))


@pytest.mark.parametrize("version", [1, 2])
def test_a_file_of_an_earlier_layout_still_reads(version: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """``data/rollout_layout_2.h5`` is of that package: seeds 0 and None, three actions each. 1 held float32."""
    path = tmp_path / "old.h5"
    shutil.copy(Path(__file__).parent / "data" / "rollout_layout_2.h5", path)
    if version == 1:
        with h5py.File(path, "r+") as file:
            file.attrs["layout_version"] = 1
            for name in ("actions", "wind", "scalars/reward", "scalars/pressure"):
                values = file[name][:].astype(np.float32)
                del file[name]
                file[name] = values
    now = gym.make("MiniCloth-Collision-v0", resolution=(5, 4)).unwrapped.scene
    rng = np.random.default_rng(0)
    with Rollout.open(path) as rollout:
        assert rollout.lengths == [4, 4]
        assert rollout.seeds == [0, None]
        # Its air was a drag of 0.5 1/s, and nothing resisted twist.
        assert rollout.material() == now.material.with_changes(drag=0.5, twist=0.0)
        assert rollout.scene == replace(now, material=rollout.material(), air=None, grips=())
        monkeypatch.setattr(Collision, "build_scene", lambda *_: rollout.scene)
        env = gym.make("MiniCloth-Collision-v0", resolution=(5, 4)).unwrapped
        env.reset(seed=0)
        assert rollout.actions().dtype == rollout.rewards().dtype == np.float64
        for frame, found in enumerate(rollout.states()):
            if frame:
                action = rng.uniform(-1, 1, 3)
                np.testing.assert_array_equal(rollout.actions()[frame], action.astype(("f4", "f8")[version - 1]))
                env.step(action)
            # That package's steps had errors of the first order.
            np.testing.assert_allclose(found.positions, env.state.positions, atol=1e-3)
            assert found.wind.dtype == found.pressure.dtype == np.float64
        with pytest.raises(ValueError, match="reset to its seed"):
            rollout.start()


def test_randomised_material_is_recorded(tmp_path: Path) -> None:
    record(tmp_path / "a.h5", "Flag", (1, 1), randomize={"areal_density": (0.1, 0.4)}, material="silk")
    with Rollout.open(tmp_path / "a.h5") as rollout:
        first, second = rollout.material(0), rollout.material(1)
        assert first.areal_density != second.areal_density
        assert first == cloth_envs.FABRICS["silk"].with_changes(areal_density=first.areal_density)


def test_recorded_spec_makes_the_environment_again(tmp_path: Path) -> None:
    seen = record(tmp_path / "a.h5", "Curtain", (0,), material={"drag": 2.0})
    with Rollout.open(tmp_path / "a.h5") as rollout:
        env = gym.make(EnvSpec.from_json(rollout.attributes["env_spec"]))
        env.reset(seed=rollout.seeds[0])
        np.testing.assert_array_equal(env.unwrapped.positions, seen[0][0].positions[0])
        assert rollout.attributes["package_version"] == cloth_envs.__version__
        assert "m, s, kg" in rollout.attributes["units"]


def test_wrapper_is_part_of_the_spec(tmp_path: Path) -> None:
    with RecordRollout(gym.make("MiniCloth-Flag-v0", **SMALL), str(tmp_path / "a.h5"), overwrite=True) as env:
        text = env.spec.to_json()
    with gym.make(EnvSpec.from_json(text)) as again:
        assert isinstance(again, RecordRollout)


def test_layout_is_that_of_the_well(tmp_path: Path) -> None:
    """The names, shapes and attributes that the_well.data.WellDataset 1.2 reads."""
    record(tmp_path / "a.h5", "Collision", (4, 4))
    with h5py.File(tmp_path / "a.h5") as file:
        assert file.attrs["n_trajectories"] == 2
        assert file.attrs["n_spatial_dims"] == 2
        assert file["dimensions/time"].shape == (2, 5)
        assert [file["dimensions"][name].shape[-1] for name in file["dimensions"].attrs["spatial_dims"]] == [9, 13]
        names = [f"{what}_{axis}" for what in ("position", "velocity") for axis in "xyz"]
        assert file["t0_fields"].attrs["field_names"].tolist() == names
        assert not any(file[group].attrs["field_names"].size for group in ("t1_fields", "t2_fields"))
        for name in names:
            field = file["t0_fields"][name]
            assert field.shape == (2, 5, 9, 13)
            assert field.dtype == np.float32
            assert field.chunks[0] == 1
            assert field.attrs["sample_varying"]
            assert field.attrs["time_varying"]
            assert field.attrs["dim_varying"].all()
        for name in file["scalars"].attrs["field_names"]:
            assert file["scalars"][name].shape == ((2, 5) if file["scalars"][name].attrs["time_varying"] else (2,))
        handles = file["boundary_conditions/handles"]
        assert handles.attrs["bc_type"] == "wall"
        np.testing.assert_array_equal(np.flatnonzero(handles["mask"]), handles["vertices"])
        assert file["colliders/positions"].shape == (2, 5, 1, 2, 3)
        assert not any(np.isnan(file[path]).any() for path in ("t0_fields/position_x", "scalars/reward", "actions"))
        assert file.attrs["dt"] == 0.02
        units = {}
        file.visititems(lambda path, item: units.update({path: item.attrs["units"]} if hasattr(item, "shape") else {}))
        assert {units["t0_fields/velocity_z"], units["scalars/pressure"], units["actions"]} == {"m/s", "Pa", "1"}


def test_tube_and_bodies_of_a_scene_outside_the_registry(tmp_path: Path) -> None:
    bodies = (cloth_envs.Collider("capsule", 0.1, 0.5, "leg"), cloth_envs.Collider("plane"))
    grid = Grid(5, 8, 0.5, 1.0, periodic=True)
    scene = cloth_envs.Scene(
        "Mine", grid, cloth_envs.Material(), 0.02, handles=(0, 3), colliders=bodies, air=cloth_envs.Air()
    )
    state = cloth_envs.State.still(np.ones((1, 3, 5, 8), np.float32), np.ones((1, 2, 2, 3), np.float32))
    with RolloutWriter(tmp_path / "a.h5", scene) as writer:
        writer.begin()
        writer.append(state)
    with Rollout.open(tmp_path / "a.h5") as rollout:
        assert rollout.scene == scene
        assert rollout.actions().shape == (1, 0)
        np.testing.assert_array_equal(rollout.state(0).colliders, state.colliders)
    with h5py.File(tmp_path / "a.h5") as file:
        assert file["boundary_conditions/closed"].attrs["bc_type"] == "periodic"


KILLED = """
import os, signal, sys
import gymnasium as gym, numpy as np
import cloth_envs
from cloth_envs.recording import RecordRollout

env = RecordRollout(gym.make("MiniCloth-Flag-v0", resolution=(9, 13)), sys.argv[1])
rng = np.random.default_rng(0)
for episode, frames in enumerate((40, int(sys.argv[2]))):
    env.reset(seed=episode)
    for _ in range(frames):
        env.step(rng.uniform(-1, 1, 2).astype(np.float32))
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.parametrize(("frames", "kept"), [(10, 0), (31, 32), (70, 64)])
def test_killed_writer_leaves_whole_frames(frames: int, kept: int, tmp_path: Path) -> None:
    """The first trajectory is whole; of the second, the start and ``frames`` more, whole chunks of 32 are there."""
    path = tmp_path / "killed.h5"
    done = subprocess.run([sys.executable, "-c", KILLED, str(path), str(frames)], check=False)
    assert done.returncode == -signal.SIGKILL
    seen = record(tmp_path / "whole.h5", "Flag", (40, frames))
    with Rollout.open(path) as rollout:
        assert rollout.lengths == [41, kept]
        for trajectory in (0, 1):
            for expected, found in zip(seen[trajectory], rollout.states(trajectory), strict=False):
                np.testing.assert_array_equal(found.positions, expected.positions)
                np.testing.assert_array_equal(found.velocities, expected.velocities)
            assert np.isfinite(rollout.actions(trajectory)).all()
            assert np.isfinite(rollout.rewards(trajectory)).all()


def test_rows_that_were_not_counted_are_cut_off(tmp_path: Path) -> None:
    """A writer killed between writing a chunk and counting it leaves longer datasets than ``frames`` says."""
    record(tmp_path / "a.h5", "Flag", (4,))
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        file["frames"][0] = 2
        file["t0_fields/position_x"].resize(9, 1)
    with Rollout.open(tmp_path / "a.h5") as rollout:
        assert len(list(rollout.states())) == len(rollout.rewards()) == len(rollout.actions()) == 2
        with pytest.raises(ValueError, match="no frame 2"):
            rollout.state(2)


def test_a_running_writer_can_be_read(tmp_path: Path) -> None:
    env = RecordRollout(gym.make("MiniCloth-Flag-v0", **SMALL), str(tmp_path / "a.h5"))
    env.reset(seed=0)
    for _ in range(31):
        env.step(np.zeros(2, np.float32))
    with Rollout.open(tmp_path / "a.h5") as rollout:
        assert rollout.lengths == [32]
    env.close()


def test_existing_file_is_kept_unless_overwritten(tmp_path: Path) -> None:
    record(tmp_path / "a.h5", "Flag", (2,))
    before = (tmp_path / "a.h5").read_bytes()
    with pytest.raises(FileExistsError, match="overwrite=True"):
        record(tmp_path / "a.h5", "Flag", (2,))
    assert (tmp_path / "a.h5").read_bytes() == before
    scene = gym.make("MiniCloth-Curtain-v0").unwrapped.scene
    RolloutWriter(tmp_path / "a.h5", scene, overwrite=True).close()
    with Rollout.open(tmp_path / "a.h5") as rollout:
        assert rollout.scene == scene
        assert rollout.lengths == []


def test_writer_refuses_with_a_remedy(tmp_path: Path) -> None:
    scene = gym.make("MiniCloth-Flag-v0", **SMALL).unwrapped.scene
    with pytest.raises(OSError, match="create the folder"):
        RolloutWriter(tmp_path / "none" / "a.h5", scene)
    (tmp_path / "folder").mkdir()
    with pytest.raises(OSError, match="choose a path"):
        RolloutWriter(tmp_path / "folder", scene, overwrite=True)
    with pytest.raises(ValueError, match="no cloth environment"):
        RolloutWriter(tmp_path / "a.h5", gym.make("CartPole-v1"))
    with RolloutWriter(tmp_path / "a.h5", scene, actions=2) as writer:
        state = cloth_envs.State.still(np.zeros((1, 3, 9, 13), np.float32))
        with pytest.raises(RuntimeError, match="begin"):
            writer.append(state)
        writer.begin()
        with pytest.raises(ValueError, match="shape"):
            writer.append(cloth_envs.State.still(np.zeros((1, 3, 9, 12), np.float32)))
        with pytest.raises(ValueError, match="actions"):
            writer.append(state, np.zeros(3))
        writer.append(state, np.zeros(2))
        with pytest.raises(ValueError, match="file of its own"):
            writer.append(state.astype("float64"), np.zeros(2))
    with Rollout.open(tmp_path / "a.h5") as rollout:
        assert rollout.lengths == [1]


@pytest.mark.parametrize("killed", [False, True])
def test_truncated_file(killed: bool, tmp_path: Path) -> None:
    """Also when its writer was killed before."""
    path = tmp_path / "a.h5"
    if killed:
        subprocess.run([sys.executable, "-c", KILLED, str(path), "40"], check=False)
    else:
        record(path, "Flag", (40,))
    content = path.read_bytes()
    for share in (0.0, 0.05, 0.5, 0.9):  # beyond, it may be a journal that has served
        (tmp_path / "cut.h5").write_bytes(content[: int(share * len(content))])
        with pytest.raises(ValueError, match="record it again"):
            Rollout.open(tmp_path / "cut.h5")


def test_reader_refuses_with_a_remedy(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="no file"):
        Rollout.open(tmp_path / "none.h5")
    (tmp_path / "text.h5").write_text("positions")
    with pytest.raises(ValueError, match="no HDF5 file"):
        Rollout.open(tmp_path / "text.h5")
    with h5py.File(tmp_path / "other.h5", "w", libver="latest") as file:
        file["positions"] = np.zeros(3)
    with pytest.raises(ValueError, match="no MiniCloth rollout"):
        Rollout.open(tmp_path / "other.h5")
    record(tmp_path / "a.h5", "Flag", (1,))
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        del file["frames"]
    with pytest.raises(ValueError, match="damaged"):
        Rollout.open(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        file.attrs["layout_version"] = LAYOUT_VERSION + 1
    with pytest.raises(ValueError, match="or a newer one"):
        Rollout.open(tmp_path / "a.h5")
