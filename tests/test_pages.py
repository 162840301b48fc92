"""Recordings whose pages have checksums: read in threads and forks, zeroed, edited by others, cut off by a kill."""

import errno
import gc
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import gymnasium as gym
import h5py
import numpy as np
import pytest

from cloth_envs.recording import RecordRollout, Rollout
from cloth_envs.recording.image import Image
from cloth_envs.recording.pages import sealed
from cloth_envs.recording.stored import StoredFile

READER = """
import sys
from cloth_envs.recording import Rollout
try:
    with Rollout.open(sys.argv[1]) as rollout:
        print(rollout.lengths)
except ValueError as error:
    print(error)
"""
FORGETFUL = """
import resource, sys
import gymnasium as gym, cloth_envs, cloth_envs.folds
from cloth_envs.recording import RecordRollout
cloth_envs.folds.warn_coarse = lambda scene: None
env = RecordRollout(gym.make("MiniCloth-Flag-v0", resolution=(9, 13)), sys.argv[1])
env.reset(seed=0)
resource.setrlimit(resource.RLIMIT_FSIZE, (10, 10))
"""


def make(path: Path, **options: object) -> RecordRollout:
    env = gym.make("MiniCloth-Flag-v0", disable_env_checker=True, resolution=(9, 13))
    return RecordRollout(env, str(path), **options)


def run(env: gym.Env, seed: int = 0, frames: int = 70) -> None:
    env.action_space.seed(seed)
    env.reset(seed=seed)
    for _ in range(frames):
        env.step(env.action_space.sample())


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A recording of three trajectories."""
    env = make(tmp_path / "a.h5")
    for seed in range(3):
        run(env, seed)
    env.close()
    return tmp_path / "a.h5"


def frames(rollout: Rollout) -> list[bytes]:
    return [s.positions.tobytes() + s.velocities.tobytes() for n in range(3) for s in rollout.states(n)]


def numbers(rollout: Rollout) -> list[bytes]:
    return [rollout.actions(n).tobytes() + rollout.rewards(n).tobytes() for n in range(3)]


def look_around(rollout: Rollout, truth: tuple[list[bytes], list[bytes]], begin: int) -> int:
    """Reads here and there. Returns how much of it was wrong."""
    wrong = 0
    for k in range(begin, begin + 60):
        number, frame = k % 3, 37 * k % 71
        state = rollout.state(frame, number)
        wrong += state.positions.tobytes() + state.velocities.tobytes() != truth[0][71 * number + frame]
        wrong += rollout.actions(number).tobytes() + rollout.rewards(number).tobytes() != truth[1][number]
    return wrong


def test_threads_share_a_rollout(path: Path) -> None:
    with Rollout.open(path) as rollout:
        truth = frames(rollout), numbers(rollout)
    with Rollout.open(path) as rollout, ThreadPoolExecutor(4) as pool:
        assert sum(pool.map(lambda k: look_around(rollout, truth, k), range(4))) == 0


def test_forks_share_a_rollout(path: Path) -> None:
    """They had one position in the file between them."""
    with Rollout.open(path) as rollout:
        truth = frames(rollout), numbers(rollout)
    for _ in range(3):
        with Rollout.open(path) as rollout:
            child = os.fork()
            if child == 0:
                code = 1
                try:
                    code = min(2, look_around(rollout, truth, 0))
                finally:
                    os._exit(code)
            wrong = look_around(rollout, truth, 1)
            assert (wrong, os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])) == (0, 0)


def test_zeroed_pages(path: Path) -> None:
    """HDF5's own checksum of zeros is 0: rewards became 0, and nobody said so."""
    with h5py.File(path) as file:
        places = [file["scalars/reward"].id.get_chunk_info(n).byte_offset for n in range(3)]
    whole = path.read_bytes()
    for place in places:
        begin = place // 4096 * 4096
        path.write_bytes(whole[:begin] + bytes(4096) + whole[begin + 4096 :])
        with pytest.raises(ValueError, match=r"a\.h5 .*checksum"), Rollout.open(path) as rollout:
            numbers(rollout)


@pytest.mark.parametrize("edited", [False, True])
def test_what_hdf5_reads_for_ever(path: Path, edited: bool) -> None:
    """Texts without a length, in HDF5's global heap: inside one call, which no signal ends."""
    if edited:
        with h5py.File(path, "a") as file:
            file.attrs["note"] = "mine"
    content = path.read_bytes()
    heap = content.index(b"GCOL")
    sector = heap // 512 + 1
    path.write_bytes(content[: 512 * sector] + bytes(512) + content[512 * (sector + 1) :])
    done = subprocess.run(
        [sys.executable, "-c", READER, str(path)], capture_output=True, text=True, timeout=20, check=True
    )
    assert "a.h5 is" in done.stdout
    assert "damaged" in done.stdout


def test_a_note_of_somebody_else_is_no_damage(path: Path) -> None:
    with Rollout.open(path) as rollout:
        truth, about = frames(rollout), rollout.attributes
    with h5py.File(path, "a") as file:
        file.attrs["note"] = "mine"
        file.attrs["n"] = 5
    with Rollout.open(path) as rollout:
        assert frames(rollout) == truth
        assert {name: str(value) for name, value in rollout.attributes.items()} == {
            **{name: str(value) for name, value in about.items()}, "note": "mine", "n": "5",
        }  # fmt: skip


def test_an_old_trailer_within_a_file_of_another_program_does_not_count(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w", libver=("v108", "v108")) as file:
        file["room"] = np.frombuffer(sealed(b"old"), np.uint8)
    assert sealed(b"old")[-12:] in (tmp_path / "a.h5").read_bytes()
    with StoredFile(tmp_path / "a.h5") as disk, h5py.File(disk) as file:
        assert file["room"][:].tobytes() == sealed(b"old")


def test_a_kill_between_any_two_writes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also within one: half of it is on the disk."""
    path, copy, put, lengths = tmp_path / "a.h5", tmp_path / "copy.h5", Image._put, [0]
    calls = 0

    def see() -> None:
        copy.write_bytes(path.read_bytes())
        with Rollout.open(copy) as rollout:
            assert rollout.lengths[0] >= lengths[-1]
            lengths.append(rollout.lengths[0])
            assert sum(np.isfinite(state.positions).all() for state in rollout.states()) == rollout.lengths[0]

    def seen(self: Image, offset: int, data: bytes) -> None:
        nonlocal calls
        calls += 1
        looks = self.commits > 0 and (calls % 5 == 0 or data[:1] != data[-1:])
        if looks and calls % 3 == 0:
            put(self, offset, data[: len(data) // 2])
            see()
        put(self, offset, data)
        if looks and calls % 3 != 0:
            see()

    env = make(path)
    env.reset(seed=0)
    monkeypatch.setattr(Image, "_put", seen)
    for _ in range(70):
        env.step(env.action_space.sample())
    env.close()
    assert {32, 64, 71} <= set(lengths)


def test_a_closed_file_is_free_although_a_fork_lives(path: Path) -> None:
    env = make(path, overwrite=True)
    run(env, frames=3)
    child = os.fork()
    if child == 0:
        time.sleep(30)
        os._exit(0)
    try:
        env.close()
        env = make(path, overwrite=True)
        run(env, frames=5)
        env.close()
    finally:
        os.kill(child, 9)
        os.waitpid(child, 0)
    with Rollout.open(path) as rollout:
        assert rollout.lengths == [6]


def test_what_another_program_has_open(path: Path) -> None:
    with h5py.File(path), pytest.raises(OSError, match="another program has it open"):
        make(path, overwrite=True)


def test_errors_of_opening_pass(path: Path) -> None:
    """Too many open files is no damage."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (3, hard))
    try:
        with pytest.raises(OSError, match="Too many open files") as told:
            Rollout.open(path)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    assert told.value.errno == errno.EMFILE


def test_errors_of_reading_pass(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with Rollout.open(path) as rollout:
        monkeypatch.setattr(os, "pread", _fails)
        with pytest.raises(OSError, match="Stale file handle"):
            frames(rollout)


def _fails(*_: object) -> bytes:
    raise OSError(errno.ESTALE, "Stale file handle")


def test_what_is_gone_is_not_said_to_be_kept(path: Path) -> None:
    env = make(path, overwrite=True)
    run(env, frames=3)
    for file in path.parent.iterdir():
        file.unlink()
    path.parent.rmdir()
    with pytest.raises(OSError, match=r"removed or replaced meanwhile.*start again") as told:
        env.close()
    assert "as it was" not in str(told.value)
    path.parent.mkdir()
    env = make(path)
    run(env, frames=40)
    path.with_name("other").write_text("other")
    path.with_name("other").replace(path)
    with pytest.raises(OSError, match="removed or replaced meanwhile") as told:
        env.close()
    assert "keeps" not in str(told.value)
    assert path.read_text() == "other"


def test_a_forgotten_recorder_says_what_is_lost(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    done = subprocess.run(
        [sys.executable, "-c", FORGETFUL, str(path)], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith(f"can't write {path} (File too large): free some space")


def test_names_that_no_file_can_have(tmp_path: Path) -> None:
    for name in ("x" * 300 + ".h5", "a\0b.h5"):
        for use in (make, lambda path: make(path, overwrite=True)):
            with pytest.raises(OSError, match=r"(?s)can't write .*choose another name"):
                use(tmp_path / name)
        with pytest.raises(FileNotFoundError, match=r"(?s)there is no file"):
            Rollout.open(tmp_path / name)
    (tmp_path / "link.h5").symlink_to(tmp_path / "none" / "a.h5")
    with pytest.raises(OSError, match=r"create the folder .*none first"):
        make(tmp_path / "link.h5")


@pytest.mark.parametrize("number", [0.0, -1, 3, True, "0", None])
def test_numbers_of_no_trajectory(path: Path, number: object) -> None:
    with Rollout.open(path) as rollout:
        uses: list[Callable[..., object]] = [rollout.actions, rollout.start, rollout.length, rollout.material]
        for use in uses:
            with pytest.raises(ValueError, match=r"there is no trajectory .* the file holds 3"):
                use(number)
        assert number == 3 or not isinstance(number, (float, str)) or _no_frame(rollout, number)


def _no_frame(rollout: Rollout, number: object) -> bool:
    with pytest.raises(ValueError, match=r"there is no frame .* trajectory 0 holds 71"):
        rollout.state(number)  # type: ignore[arg-type]
    return True


def test_frames_end_where_the_file_is_closed(path: Path) -> None:
    rollout = Rollout.open(path)
    states = rollout.states()
    next(states)
    rollout.close()
    with pytest.raises(ValueError, match="has been closed"):
        next(states)
    assert rollout.length(np.int64(1)) == 71
    rollout = Rollout.open(path)
    file = rollout._file._image
    del rollout, states
    gc.collect()
    assert file.closed


def test_a_fork_while_a_thread_reads(tmp_path: Path) -> None:
    code = """
import os, sys, threading
import cloth_envs, gymnasium as gym
from cloth_envs.recording import RecordRollout, Rollout
env = RecordRollout(gym.make("MiniCloth-Flag-v0", resolution=(9, 13)), sys.argv[1])
env.reset(seed=0)
for _ in range(3):
    env.step(env.action_space.sample())
env.close()
rollout, going = Rollout.open(sys.argv[1]), True
def read():
    while going:
        rollout.rewards(0)
thread = threading.Thread(target=read)
thread.start()
for _ in range(4):
    child = os.fork()
    if child == 0:
        os._exit(len(rollout.rewards(0)))
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
going = False
thread.join()
"""
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code, str(tmp_path / "a.h5")],
        capture_output=True, text=True, check=True, timeout=60,
    )  # fmt: skip
    assert done.stdout.split() == ["4"] * 4


def test_a_trailer_is_found_behind_a_long_part_of_the_next(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    env = RecordRollout(gym.make("MiniCloth-Flag-v0", resolution=(9, 13)), str(tmp_path / "a.h5"))
    env.reset(seed=0)
    env.close()
    with (tmp_path / "a.h5").open("ab") as file:
        file.write(b"part of the next" * 1000)
    monkeypatch.setattr("cloth_envs.recording.pages.SEARCHED", (100, 2**20))
    with Rollout.open(tmp_path / "a.h5") as rollout:
        assert rollout.lengths == [1]


def test_a_reset_past_the_recorder_is_a_reset(tmp_path: Path) -> None:
    env = RecordRollout(gym.make("MiniCloth-Flag-v0", resolution=(9, 13)), str(tmp_path / "a.h5"))
    env.reset(seed=1)
    env.step(np.zeros(2))
    env.unwrapped.reset(seed=7)
    env.step(np.zeros(2))
    env.unwrapped.set_positions(env.unwrapped.positions)
    env.step(np.zeros(2))
    env.close()
    with Rollout.open(tmp_path / "a.h5") as rollout:
        assert rollout.resets == [True, True, False]


def test_an_empty_file_is_told(tmp_path: Path) -> None:
    (tmp_path / "a.h5").touch()
    with pytest.raises(ValueError, match=r"a\.h5 is empty, its writer has flushed nothing"):
        Rollout.open(tmp_path / "a.h5")
