"""Files that can't be written: one OSError that names them, nothing broken left, what was there stays."""

import errno
import gc
import os
import shutil
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from cloth_envs.files import replacing, write_text
from cloth_envs.recording import RecordRollout, Rollout
from cloth_envs.recording.image import Image

RECORDER = """
import gc, resource, sys
import gymnasium as gym, numpy as np, cloth_envs, cloth_envs.folds
from cloth_envs.recording import RecordRollout
cloth_envs.folds.warn_coarse = lambda scene: None
limit = int(sys.argv[2])
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
env = RecordRollout(gym.make("MiniCloth-Flag-v0", resolution=(9, 13)), sys.argv[1], overwrite=True)
try:
    for seed in range(3):
        env.reset(seed=seed)
        for _ in range(45):
            env.step(np.zeros(2))
    env.close()
except OSError as error:
    print(error)
    env.close()
del env
gc.collect()
"""


def make(path: Path, **options: object) -> RecordRollout:
    env = gym.make("MiniCloth-Flag-v0", disable_env_checker=True, resolution=(9, 13))
    return RecordRollout(env, str(path), **options)


def run(env: gym.Env, frames: int = 40) -> None:
    env.reset(seed=0)
    for _ in range(frames):
        env.step(np.zeros(2))


@pytest.mark.parametrize("old", [False, True])
@pytest.mark.parametrize(("limit", "lengths"), [(0, None), (50_000, [0]), (250_000, [32])])
def test_a_full_disk_is_one_error(limit: int, lengths: list[int] | None, old: bool, tmp_path: Path) -> None:
    """libhdf5 alone ends in a segmentation fault when it is closed after a failed flush (h5py #914)."""
    path = tmp_path / "a.h5"
    if old:
        path.write_text("old")
    done = subprocess.run(
        [sys.executable, "-c", RECORDER, str(path), str(limit)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert not done.stderr
    (told,) = done.stdout.splitlines()
    assert f"can't write {path} (File too large): free some space" in told
    kept = path.with_name("a.h5.part") if old else path
    if lengths is None or (old and lengths == [0]):
        assert os.listdir(tmp_path) == ["a.h5"] * old
    else:
        assert str(kept) in told
        with Rollout.open(kept) as rollout:
            assert rollout.lengths == lengths
            assert all(np.isfinite(state.positions).all() for state in rollout.states())
    if old:
        assert path.read_text() == "old"
        assert "as it was" in told


def test_a_write_that_fails_anywhere_leaves_what_was_committed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The n-th write fails, for every n of a small recording; also where a journal is written but not yet applied."""
    put, calls, lengths = Image._put, 0, set()

    def fails(self: Image, offset: int, data: bytes) -> None:
        nonlocal calls
        calls += 1
        if calls >= limit:
            put(self, offset, data[: len(data) // 2])
            raise OSError(errno.EIO, "Input/output error")
        put(self, offset, data)

    limit, told = 0, "nothing yet"
    monkeypatch.setattr(Image, "_put", fails)
    while told:
        limit, calls, told = limit + 7, 0, ""
        path = tmp_path / f"{limit}.h5"
        env = make(path)
        try:
            run(env, 70)
            env.close()
        except OSError as error:
            told = str(error)
        assert not told or f"can't write {path} (Input/output error)" in told
        env.close()
        with pytest.raises(ValueError, match="is closed"):
            env.step(np.zeros(2))
        if path.exists():
            with Rollout.open(path) as rollout:
                lengths.add(rollout.lengths[0])
                assert sum(np.isfinite(state.positions).all() for state in rollout.states()) == rollout.lengths[0]
    assert lengths == {0, 32, 64, 71}


def test_a_disk_that_is_gone(tmp_path: Path) -> None:
    """Neither reads nor writes go through any more."""
    env = make(tmp_path / "a.h5")
    run(env)
    os.close(env.writer._file._image._disk.fileno())
    with pytest.raises(OSError, match=r"can't write .*a\.h5 \(Bad file descriptor\)"):
        run(env, 80)
    env.close()
    with Rollout.open(tmp_path / "a.h5") as rollout:
        assert rollout.lengths == [32]


def test_a_file_that_is_removed_meanwhile(tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    env = make(folder / "a.h5")
    run(env)
    shutil.rmtree(folder)
    with pytest.raises(OSError, match="removed or replaced"):
        env.close()
    env.close()
    assert not folder.exists()


def test_two_writers(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    first = make(path)
    run(first)
    with pytest.raises(OSError, match="another program has it open"):
        make(path, overwrite=True)
    first.close()
    second = make(path, overwrite=True)
    run(second, 2)
    with pytest.raises(OSError, match="another program has it open"):
        make(path, overwrite=True)
    with Rollout.open(path) as reader:  # of the old file, also after it was replaced
        assert reader.lengths == [41]
        second.close()
        assert len(list(reader.states())) == 41
    with Rollout.open(path) as reader:
        assert reader.lengths == [3]
    assert os.listdir(tmp_path) == ["a.h5"]


def test_a_forgotten_recorder_and_a_fork_of_it(tmp_path: Path) -> None:
    def record() -> int:
        env = make(tmp_path / "a.h5")
        run(env, 7)
        child = os.fork()
        if child == 0:
            try:
                env.close()
                run(env, 40)
            except OSError as error:
                os._exit(3 if "fork" in str(error) else 4)
            os._exit(5)
        status = os.waitpid(child, 0)[1]
        run(env, 2)
        return os.waitstatus_to_exitcode(status)

    assert record() == 3
    gc.collect()
    with Rollout.open(tmp_path / "a.h5") as rollout:
        assert rollout.lengths == [8, 3]


@pytest.mark.parametrize("path", ["/dev/null", "{}", "{}/pipe"])
def test_what_is_no_file_stays(path: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    place = Path(path.format(tmp_path))
    for overwrite in (False, True):
        with pytest.raises(OSError, match="no folder and no device"):
            make(place, overwrite=overwrite)
    with pytest.raises(OSError, match="no folder and no device"):
        write_text(place, "text")
    with pytest.raises(FileNotFoundError, match="there is no file"):
        Rollout.open(place)
    assert place.exists()


def _half(part: Path, error: BaseException) -> None:
    part.write_text("half")
    raise error


def test_replacing_leaves_the_old_file_or_the_new_one(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")
    for error in (OSError(errno.ENOSPC, "No space left on device"), KeyboardInterrupt()):
        with pytest.raises(type(error)) as told, replacing(path) as part:
            _half(part, error)
        if isinstance(error, OSError):
            assert str(told.value).startswith(f"can't write {path} (No space left on device): free some space")
            assert told.value.errno == errno.ENOSPC
        assert path.read_text() == "old"
        assert os.listdir(tmp_path) == ["a.txt"]
    (tmp_path / "link.txt").symlink_to(path)
    write_text(tmp_path / "link.txt", "new")
    assert path.read_text() == "new"
    assert (tmp_path / "link.txt").is_symlink()
    with pytest.raises(OSError, match="create the folder"):
        write_text(tmp_path / "none" / "a.txt", "text")


WRITERS = """
import errno, os, resource, sys
from pathlib import Path
import numpy as np
folder = Path(sys.argv[1])
from cloth_envs.commands.outputs import open_video, write_pictures
from cloth_envs.style import import_figure
from surrogates import checkpoint
from training.bench import charts
from training.bench.stability.rows import StabilityRow
from training.cache import cached_arrays
from training.fit import Kept
from training.generate import Plan, write_shard
from training.superres.generate import Plan as Pairs, write_sequence
from training.rows import write_rows
from dataclasses import dataclass

@dataclass
class Number:
    value: int

def video():
    with open_video(folder / "a.mp4", 25) as add:
        for _ in range(50):
            add(np.random.default_rng(0).integers(0, 255, (480, 640, 3), np.uint8))

big = np.random.default_rng(0).normal(size=40_000)
import torch
figure = import_figure()(figsize=(4, 3)); figure.add_subplot().plot(big)
jobs = {
    "a.mp4": video,
    "a.csv": lambda: write_rows(folder / "a.csv", [Number(i) for i in range(20_000)]),
    "a.npz": lambda: cached_arrays(folder / "a.npz", lambda: {"a": big}),
    "a.safetensors": lambda: checkpoint.save("a", {"a": big}, {}, folder),
    "a.pt": lambda: Kept(folder / "a.pt", "mark").write(a=torch.tensor(big)),
    "a.png": lambda: charts.save(figure, "note", folder, "a"),
    "00000.h5": lambda: write_shard(Plan("Flag", frames=5), folder, 0),
    "000.h5": lambda: write_sequence(Pairs("Draping", 5), folder, 0),
}
resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000))
for name, job in jobs.items():
    try:
        job()
        print(name, "was written")
    except OSError as error:
        told = str(error)
        print(told.count("can't write") == 1 and f"{name} (File too large): free some space" in told, name, told)
print([file for *_, files in os.walk(folder) for file in files])
"""


def test_all_other_writers(tmp_path: Path) -> None:
    """Videos, rows, cached arrays, weights, trainings, charts and data sets on a full disk."""
    pytest.importorskip("torch")
    done = subprocess.run([sys.executable, "-c", WRITERS, str(tmp_path)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    *lines, left = done.stdout.splitlines()
    assert [line for line in lines if not line.startswith("True")] == []
    assert len(lines) == 8
    assert left == "[]"
    assert "Traceback" not in done.stderr


IMAGES = """
import resource, signal, sys
from cloth_envs.commands.cli import main
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
sys.exit(main(["rollout", "Flag", "--resolution", "9x13", "--frames", "2", "--images", sys.argv[1]]))
"""


def test_images_on_a_disk_that_takes_nothing(tmp_path: Path) -> None:
    """imageio told of it once more, in a traceback, when its writer was dropped."""
    pytest.importorskip("pyvista")
    done = subprocess.run([sys.executable, "-c", IMAGES, str(tmp_path)], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "frame_00000.png (File too large): free some space" in done.stderr
    assert "Traceback" not in done.stderr
    assert os.listdir(tmp_path) == []
