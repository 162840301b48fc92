"""Damaged files: either what was written, or within seconds a ValueError that names the file."""

import json
import random
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from safetensors.numpy import save as serialise

from cloth_envs.recording import RecordRollout, Rollout
from surrogates import checkpoint
from training.cache import cached_arrays
from training.generate import Plan, write_shard
from training.rows import read_rows, write_rows
from training.upscaler.data import data_hash, read

RECORDER = """
import os, signal, sys
import gymnasium as gym, numpy as np, cloth_envs
from cloth_envs.recording import RecordRollout
env = RecordRollout(gym.make("MiniCloth-Collision-v0", resolution=(5, 6)), sys.argv[1])
rng = np.random.default_rng(0)
for seed in (2**70, None):
    env.reset(seed=seed)
    for _ in range(35):
        env.step(rng.uniform(-1, 1, 3))
if sys.argv[2] == "killed":
    os.kill(os.getpid(), signal.SIGKILL)
env.close()
"""


@pytest.fixture(autouse=True)
def no_hang() -> Iterator[None]:
    """A file that is read for ever fails the test."""
    signal.signal(signal.SIGALRM, lambda *_: pytest.fail("read for more than 30 s"))
    signal.alarm(30)
    yield
    signal.alarm(0)


def contents(path: Path) -> list[object]:
    """Everything that a rollout says."""
    with Rollout.open(path) as rollout:
        found: list[object] = [rollout.scene, rollout.lengths, rollout.seeds, rollout.resets]
        found.append({name: str(value) for name, value in rollout.attributes.items()})
        for trajectory in range(len(rollout.lengths)):
            arrays = [rollout.actions(trajectory), rollout.rewards(trajectory), *rollout.start(trajectory).values()]
            for state in rollout.states(trajectory):
                arrays += state.arrays().values()
            found += [rollout.material(trajectory), *(array.tobytes() for array in arrays)]
    return found


def attempt(look: Callable[[], Any], path: Path) -> Any:
    """What ``look`` gives, or None where it says that ``path`` is damaged."""
    try:
        return look()
    except ValueError as error:
        told = str(error)
    assert str(path) in told
    return None


def damaged(content: bytes, kinds: int, seed: int) -> Iterator[bytes]:
    """Copies with a bit flipped, cut short, and with noise in them."""
    rng = random.Random(seed)
    for number in range(kinds):
        at, copy = rng.randrange(len(content)), bytearray(content)
        if number % 3 == 0:
            copy[at] ^= 1 << rng.randrange(8)
        elif number % 3 == 1:
            del copy[at:]
        else:
            length = min(rng.choice([16, 512, 4096]), len(copy) - at)
            copy[at : at + length] = rng.randbytes(length)
        yield bytes(copy)


@pytest.mark.parametrize("how", ["closed", "killed"])
def test_a_damaged_recording(how: str, tmp_path: Path) -> None:
    """A byte in the file of a killed writer made HDF5 read for ever."""
    path, bad = tmp_path / "a.h5", tmp_path / "bad.h5"
    subprocess.run([sys.executable, "-c", RECORDER, str(path), how], check=False)
    truth, told = contents(path), 0
    assert truth[1] == ([36, 36] if how == "closed" else [36, 32])
    for content in damaged(path.read_bytes(), 120, seed=0):
        bad.write_bytes(content)
        found = attempt(lambda: contents(bad), bad)
        assert found in (None, truth)
        told += found is None
    assert told > 50


@dataclass
class Number:
    value: int
    share: float


def test_damaged_rows_weights_and_arrays(tmp_path: Path) -> None:
    """What has a checksum is never read wrong; text is told where it can't be read."""
    rows, arrays = [Number(1, 0.5), Number(2, 0.25)], {"a": np.arange(60.0), "b": np.arange(4)}
    write_rows(tmp_path / "rows.csv", rows)
    head = b"value,share\r\n"
    for content in (b"", head + b"1", head + b"1,2,3\r\n", head + b'"1,2', head + b"1,x", b"\xff\xfe", b"a,b\r\n1,2"):
        (tmp_path / "rows.csv").write_bytes(content)
        with pytest.raises(ValueError, match=r"rows\.csv .*remove it"):
            read_rows(tmp_path / "rows.csv", Number)
    write_rows(tmp_path / "rows.csv", rows)
    whole_rows = (tmp_path / "rows.csv").read_bytes()
    cuts = [whole_rows[:length] for length in range(len(whole_rows) - 2)]
    for content in (*damaged(whole_rows, 200, seed=5), *cuts):
        (tmp_path / "rows.csv").write_bytes(content)
        found = attempt(lambda: read_rows(tmp_path / "rows.csv", Number), tmp_path / "rows.csv")
        assert found in (None, rows)
    (tmp_path / "rows.csv").write_bytes(whole_rows.replace(b"\r\n", b"\n"))  # as some editors and git write it
    assert read_rows(tmp_path / "rows.csv", Number) == rows
    path = tmp_path / "a.npz"
    cached_arrays(path, lambda: arrays)
    for content in damaged(path.read_bytes(), 150, seed=1):
        path.write_bytes(content)
        found = attempt(lambda: cached_arrays(path, dict), path)
        for name, array in arrays.items() if found is not None else ():
            assert found[name].tobytes() == array.tobytes()
    checkpoint.save("w", arrays, {"factors": {"2": 0.125}, "seed": 1}, tmp_path)
    content = (tmp_path / "w.safetensors").read_bytes()
    card = content.index(b"seed")
    flips = [content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :] for at in range(card - 60, card + 10)]
    for copy in (*damaged(content, 90, seed=2), *flips, b"", b"[]", 8 * b"\0", serialise(arrays)):
        (tmp_path / "w.safetensors").write_bytes(copy)
        checkpoint.load.cache_clear()
        with pytest.raises(ValueError, match=r"w\.safetensors is damaged .*restore it"):
            checkpoint.load("w", tmp_path)


def test_a_damaged_training(tmp_path: Path) -> None:
    """Torch does not look at the checksums of its own files."""
    torch = pytest.importorskip("torch")
    from training.fit import Kept

    kept = Kept(tmp_path / "a.pt", "mark")
    kept.write(net=torch.arange(200.0), done=3)
    content = (tmp_path / "a.pt").read_bytes()
    for copy in damaged(content, 90, seed=3):
        (tmp_path / "a.pt").write_bytes(copy)
        found = attempt(kept.read, kept.path)
        assert found is None or torch.equal(found["net"], torch.arange(200.0))
    (tmp_path / "a.pt").write_bytes(content)
    with pytest.raises(ValueError, match="another recipe"):
        Kept(tmp_path / "a.pt", "other").read()


def test_a_damaged_data_set(tmp_path: Path) -> None:
    plan = Plan("Flag", frames=5, window=5, factors=(2,))
    write_shard(plan, tmp_path, 0)
    path = tmp_path / "00000.h5"
    truth, told, whole = read(path, 2), 0, path.read_bytes()
    zeroed = [whole[:at] + bytes(512) + whole[at + 512 :] for at in (*range(0, 20_000, 512), len(whole) - 512)]
    for content in (*damaged(whole, 90, seed=4), *zeroed):
        path.write_bytes(content)
        found = attempt(lambda: read(path, 2), path)
        told += found is None
        for name, value in vars(truth).items() if found is not None else ():
            assert np.array_equal(getattr(found, name), value)
    assert told > 30
    path.write_bytes(b"nothing")
    with pytest.raises(ValueError, match=r"00000\.h5 is damaged .*minicloth generate"):
        data_hash([path])


def test_what_is_closed_or_open_to_nobody(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    env = RecordRollout(gym.make("MiniCloth-Flag-v0", resolution=(9, 13)), str(path))
    env.reset(seed=0)
    env.step(np.zeros(2))
    env.close()
    for use in (lambda: env.step(np.zeros(2)), env.reset):
        with pytest.raises(ValueError, match=r"a\.h5 is closed: make a new recorder"):
            use()
    rollout = Rollout.open(path)
    rollout.close()
    rollout.close()
    for use in (rollout.actions, rollout.rewards, rollout.start, rollout.material, lambda: rollout.state(0)):
        with pytest.raises(ValueError, match=r"a\.h5 has been closed: open it again"):
            use()


def test_a_reader_follows_a_writer_that_goes_on(tmp_path: Path) -> None:
    """What it opened stays the same, bit for bit, while the file grows under it."""
    path = tmp_path / "a.h5"
    env = RecordRollout(gym.make("MiniCloth-Flag-v0", resolution=(9, 13)), str(path))
    rng = np.random.default_rng(0)
    env.reset(seed=0)
    for _ in range(40):
        env.step(rng.uniform(-1, 1, 2))
    with Rollout.open(path) as rollout:
        assert rollout.lengths == [32]
        first = [state.positions for state in rollout.states()]
        for episode in range(20):
            env.reset(seed=episode)
            for _ in range(3):
                env.step(rng.uniform(-1, 1, 2))
            assert rollout.lengths == [32]
            np.testing.assert_array_equal(rollout.state(episode % 32).positions, first[episode % 32])
    shutil.copy(path, tmp_path / "copy.h5")  # as it is on the disk now
    env.close()
    with Rollout.open(tmp_path / "copy.h5") as copy, Rollout.open(path) as whole:
        assert copy.lengths == [*whole.lengths[:-1], 0]
        assert json.loads(copy.attributes["env_spec"])["id"] == "MiniCloth-Flag-v0"


@dataclass(frozen=True)
class Note:
    name: str
    text: str


@pytest.mark.parametrize("text", ["x\r", "\r", "a\rb", "a\r\nb", "a\nb", 'say "a"', "# crc32 00000000,", ""])
def test_rows_keep_every_text(text: str, tmp_path: Path) -> None:
    rows = [Note("a", text), Note(text + "b", "c")]
    write_rows(tmp_path / "notes.csv", rows)
    assert read_rows(tmp_path / "notes.csv", Note) == rows
