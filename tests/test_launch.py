"""What a frame of an environment on a device costs beside the physics: how much is launched, and what comes back."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import cloth_envs
from cloth_envs.scenes.drives import GUST_TONES

torch = pytest.importorskip("torch", reason="needs the extra 'train'")
from on_tensors import THERE, N, actions_of, assert_same, frail, made  # noqa: E402
from torch.overrides import TorchFunctionMode  # noqa: E402

from cloth_envs.launch import OneLaunch  # noqa: E402

LIMIT, FRAMES = 6, 14  # frames of an episode; frames stepped


class Tape(TorchFunctionMode):
    """Keeps calls of torch, and repeats them as a CUDA graph does: on tensors where they lay, all else as it was."""

    def __init__(self) -> None:
        super().__init__()
        self.calls: list[Any] = []

    def __torch_function__(self, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        result = function(*args, **kwargs or {})
        self.calls.append((function, args, kwargs or {}, result))
        return result

    def play(self, wanted: list[Any]) -> list[Any]:
        made: dict[int, Any] = {}

        def now(value: Any) -> Any:
            return type(value)(map(now, value)) if type(value) in (list, tuple) else made.get(id(value), value)

        for function, args, kwargs, result in self.calls:
            found = function(*now(args), **kwargs)
            pairs = zip(result, found, strict=True) if isinstance(result, (list, tuple)) else [(result, found)]
            made |= {id(old): new for old, new in pairs if isinstance(old, torch.Tensor)}
        return now(wanted)


class Taped(OneLaunch):
    def __call__(self) -> Any:
        if not self._results:
            self.tape = Tape()
            with self.tape:
                self._results = list(self._function())
        return self.tape.play(self._results)


@pytest.mark.parametrize("scene", cloth_envs.EPISODE_FRAMES)
def test_a_recorded_frame_is_the_computed_one(scene: str, monkeypatch: pytest.MonkeyPatch) -> None:
    computed, recorded = (made(scene, **THERE, output="torch", max_episode_steps=LIMIT) for _ in range(2))
    frail(computed)
    frail(recorded)
    first = computed.reset(seed=1)
    monkeypatch.setattr("cloth_envs.device.OneLaunch", Taped)
    assert_same(recorded.reset(seed=1), first)
    rng = np.random.default_rng(0)
    ended = 0
    for _ in range(FRAMES):
        actions = torch.from_numpy(actions_of(computed, rng))
        answers, expected = recorded.step(actions), computed.step(actions)
        assert all(map(torch.equal, answers[:4], expected[:4]))
        ended += int((expected[2] | expected[3]).sum())
    assert ended > N


class Watching(TorchFunctionMode):
    """Counts the calls of torch that are no views, and keeps what they bring from one side to the other."""

    VIEWS = ("__get__", "__getitem__", "__len__", "reshape", "permute", "unbind", "detach", "size", "dim", "expand")
    CROSSINGS = "cpu", "numpy", "tolist", "item", "__bool__", "__array__", "nonzero", "tensor", "from_numpy"

    def __init__(self) -> None:
        super().__init__()
        self.count, self.sent = 0, []

    def __torch_function__(self, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        self.count += function.__name__ not in self.VIEWS
        if function.__name__ in self.CROSSINGS:
            self.sent.append((function.__name__, torch.Size(np.shape(args[0])).numel()))
        return function(*args, **kwargs or {})


@pytest.mark.parametrize("scene", cloth_envs.EPISODE_FRAMES)
def test_a_step_is_few_operations_of_which_two_flags_come_back(scene: str) -> None:
    """On a GPU each costs a launch, and what comes back waits for all of them."""
    counts = []
    for n in (2, 5):
        env = made(scene, num_envs=n, backend="on_tensors:Still", output="torch", randomize=None)
        env.reset(seed=0)
        actions = torch.zeros(env.action_space.shape)
        with Watching() as watched:
            env.step(actions)
        assert watched.sent == [("tolist", 2)]
        counts.append(watched.count)
    assert counts[0] == counts[1]
    most = 700 if scene.startswith("Skirt") else 160  # fifteen joints' splines, turned and made capsules of thrice
    assert counts[0] < most + 20 * scene.endswith("-v1")


def test_a_reset_in_a_step_sends_no_more_than_the_members_that_it_starts() -> None:
    env = made("Flag", num_envs=50, backend="on_tensors:Still", output="torch", randomize=None, max_episode_steps=3)
    env.reset(seed=0)
    actions = torch.zeros(env.action_space.shape)
    for _ in range(2):
        env.step(actions)
    env.reset(options={"reset_mask": np.arange(50) != 7})
    for frame in (3, 0):  # of the member left out: its last one, and the start of its next episode
        with Watching() as watched:
            env.step(actions)
        assert env.world.frames[7] == frame
        assert max(size for _, size in watched.sent) <= 4 + 4 * GUST_TONES  # what is random of one start
