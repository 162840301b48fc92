"""The evaluator: equal seeds, intervals, warnings; policies by name, function and file; the example that trains one."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import warnings
import zipfile
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import cloth_envs
from cloth_envs.agents import load_policy, mlp
from cloth_envs.commands.cli import main
from cloth_envs.commands.evaluate import evaluate
from cloth_envs.commands.rollout import rollout
from cloth_envs.evaluation import ALLOWED, Interval, Played, Verdict, play
from cloth_envs.policies import CONTROLLERS

ROOT = Path(__file__).parents[1]
SMALL: dict[str, Any] = {"resolution": (13, 17), "frames": 12}


def full(seen: np.ndarray) -> np.ndarray:
    """Full action, for ``test_evaluate:full``."""
    return np.ones((len(seen), 2))


def played(rewards: np.ndarray, failures: int = 0) -> Played:
    n = len(rewards)
    lost = ["overstretch"] * failures + [None] * (n - failures)
    return Played(rewards, rewards, np.zeros(n, bool), lost, np.zeros(n), np.zeros(n))


def test_an_episode_is_that_of_the_environment() -> None:
    found = play("Hanging", CONTROLLERS["Hanging"], [3, 4], **SMALL)
    env = gym.make(cloth_envs.env_id("Hanging"), resolution=(13, 17), max_episode_steps=12)
    for i, seed in enumerate((3, 4)):
        seen, _ = env.reset(seed=seed)
        rewards, moves = [], []
        for _ in range(12):
            moves.append(np.clip(CONTROLLERS["Hanging"](seen), -1, 1))
            seen, reward, *_, info = env.step(moves[-1])
            rewards.append(reward)
        assert found.reward[i] == pytest.approx(np.mean(rewards), rel=1e-12)
        assert found.last_second[i] == pytest.approx(info["final_second"], rel=1e-12)
        assert found.success[i] == info["success"]
        assert found.change[i] == pytest.approx(abs(np.diff(moves, axis=0)).mean(), rel=1e-6)
        assert found.saturated[i] == pytest.approx((abs(np.array(moves)) == 1).mean())
    assert found.failures == [None, None]


def test_equal_seeds_leave_no_noise_between_equal_physics() -> None:
    options = {"policy": load_policy("controller", "Flag"), "seeds": range(5)}
    verdict = Verdict(play("Flag", **options, **SMALL), play("Flag", backend="cnn", **options, **SMALL))
    assert (verdict.gap.mean, verdict.gap.half) == (0, 0)  # it is the reference to the bit
    assert verdict.unpaired > 0.01


def test_intervals_hold_the_mean_as_often_as_they_say() -> None:
    rng = np.random.default_rng(0)
    intervals = [Interval.of(rng.normal(0.3, 0.1, 8)) for _ in range(2000)]
    inside = np.mean([abs(each.mean - 0.3) < each.half for each in intervals])
    assert inside == pytest.approx(0.95, abs=4 * (0.95 * 0.05 / 2000) ** 0.5)  # four standard errors
    start = np.repeat(np.linspace(0.1, 0.9, 8)[None], 2, 0)  # that both physics share
    gap = Verdict(*(played(row + rng.normal(0, 0.01, 8)) for row in start))
    assert gap.gap.half < 0.1 * gap.unpaired


def test_what_exploits_or_fails_is_told_and_what_does_not_is_not() -> None:
    rng = np.random.default_rng(1)
    noise, base = rng.normal(0, 0.003, 16), rng.uniform(0.3, 0.8, 16)
    honest = Verdict(played(base + noise), played(base))
    cheat = Verdict(played(base + 0.1 + noise), played(base, failures=4))
    assert honest.warnings({}) == []
    assert honest.gap.half < ALLOWED
    words = " ".join(cheat.warnings({"controller": honest}))
    assert "it exploits its physics" in words
    assert "larger than that of controller" in words
    assert "it fails in 25% of the episodes that count, in 0% of its own" in words
    assert "larger" not in " ".join(cheat.warnings({"other": cheat}))  # the physics explains it
    even = Verdict(played(base, failures=4), played(base, failures=4))
    assert even.warnings({}) == ["it fails in 25% of the episodes that count, in 25% of its own"]
    vague = Verdict(played(base + rng.normal(0, 0.2, 16)), played(base))
    assert any("take more seeds" in warning for warning in vague.warnings({}))


def test_failures_are_told_and_end_what_is_earned() -> None:
    class Broken(cloth_envs.scenes.flag.Flag):
        max_strain = 0.02

    found = play(Broken, full, [0, 1], frames=20, resolution=(13, 17))  # type: ignore[arg-type]
    whole = play("Flag", full, [0, 1], frames=20, resolution=(13, 17))
    assert found.failures == ["overstretch"] * 2
    assert found.failed == found.failed_at_most == 1
    assert (found.reward < whole.reward).all()
    assert (found.last_second == 0).all() or (found.last_second < whole.last_second).all()


def test_policies_by_name_function_and_file(tmp_path: Path) -> None:
    seen = np.random.default_rng(0).normal(size=(3, 128)).astype(np.float32)
    assert load_policy("zero", "Flag")(seen).tolist() == [[0, 0]] * 3
    assert load_policy("test_evaluate:full", "Flag")(seen).tolist() == [[1, 1]] * 3
    assert load_policy("controller", "Flag") is CONTROLLERS["Flag"]
    a, b = (load_policy("random", "Flag")(seen) for _ in range(2))
    assert np.array_equal(a, b)
    torch = pytest.importorskip("torch", reason="needs the extra 'train'")
    net = torch.nn.Sequential(torch.nn.Linear(128, 8), torch.nn.Tanh(), torch.nn.Linear(8, 2))
    scale = {"mean": torch.linspace(-1, 1, 128), "spread": torch.linspace(0.5, 2, 128)}
    torch.save(scale | net.state_dict(), tmp_path / "mine.pt")
    want = net(((torch.as_tensor(seen) - scale["mean"]) / scale["spread"]).clamp(-10, 10)).clamp(-1, 1)
    got = load_policy(str(tmp_path / "mine.pt"), "Flag")(seen)
    np.testing.assert_allclose(got, want.detach().numpy(), atol=1e-5)


def test_a_model_of_stable_baselines(tmp_path: Path) -> None:
    sb3 = pytest.importorskip("stable_baselines3", reason="needs the extra 'rl'")
    seen = np.random.default_rng(0).normal(size=(3, 128)).astype(np.float32)
    env = gym.make(cloth_envs.env_id("Flag"), resolution=(13, 17))
    for algorithm in ("PPO", "SAC"):
        model = getattr(sb3, algorithm)("MlpPolicy", env, device="cpu")
        model.save(tmp_path / algorithm)
        got = load_policy(str(tmp_path / f"{algorithm}.zip"), "Flag")(seen)
        np.testing.assert_array_equal(got, model.predict(seen, deterministic=True)[0])


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("controler", "controller"),
        ("nothing.pt", "there is no file nothing.pt"),
        ("cloth_envs.policies:POLICIES", "no function of observations"),
    ],
)
def test_what_is_no_policy_is_refused(name: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        load_policy(name, "Flag")


def test_files_that_are_no_policies_are_refused(tmp_path: Path) -> None:
    for suffix in (".zip", ".pt"):
        bad = tmp_path / f"bad{suffix}"
        bad.write_bytes(b"nothing")
        with pytest.raises((ValueError, ImportError), match=r"is no (model|file)|needs"):
            load_policy(str(bad), "Flag")
    with pytest.raises(ValueError, match="holds mean, spread"):
        mlp({"0.weight": np.zeros((2, 2))})


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_actions_that_are_no_numbers_are_refused_with_their_frame(value: float) -> None:
    calls = []

    def act(seen: np.ndarray) -> np.ndarray:
        calls.append(1)
        return np.full((len(seen), 2), value if len(calls) > 3 else 0.0)

    with pytest.raises(ValueError, match="policy's actions in frame 3 on reference hold NaN"):
        play("Flag", act, [0], **SMALL)
    with pytest.raises(ValueError, match=r"policy in frame 0 on reference: action has shape \(2,\)"):
        play("Flag", lambda seen: np.zeros(2), [0], **SMALL)


def test_files_of_torch_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    torch = pytest.importorskip("torch", reason="needs the extra 'train'")
    net = torch.nn.Sequential(torch.nn.Linear(5, 4), torch.nn.Tanh(), torch.nn.Linear(4, 2))
    ours = {"mean": torch.zeros(5), "spread": torch.ones(5), **net.state_dict()}
    path, seen = tmp_path / "policy.pt", np.zeros((3, 6), np.float32)
    wrong = {
        "no tensors by name": [net, {"model": net.state_dict()}, [1, 2]],
        "holds mean, spread": [{name: ours[name] for name in ours if name != "2.bias"}],
        "0.weight of a policy's file must have shape": [ours | {"mean": torch.zeros(6)}],
    }
    for words, contents in wrong.items():
        for content in contents:
            torch.save(content, path)
            with pytest.raises(ValueError, match=words):
                load_policy(str(path), "Flag")
    torch.save(ours, path)
    with pytest.raises(ValueError, match="reads observations of 5 numbers"):
        load_policy(str(path), "Flag")(seen)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # torch.jit is old, its files are many
        torch.jit.trace(net.double(), torch.zeros(1, 5).double()).save(path)
        policy = load_policy(str(path), "Flag")
    want = net(torch.zeros(3, 5).double()).detach().numpy()
    np.testing.assert_allclose(policy(seen[:, :5]), want, atol=1e-6)
    with pytest.raises(ValueError, match=r"can't read observations of shape \(3, 6\)"):
        policy(seen)


def test_models_and_modules_read_meshes_where_they_were_trained_on_them(tmp_path: Path) -> None:
    sb3 = pytest.importorskip("stable_baselines3", reason="needs the extra 'rl'")
    env = gym.make(cloth_envs.env_id("Flag"), resolution=(13, 17), obs="mesh")
    model = sb3.PPO("MultiInputPolicy", env, device="cpu")
    model.save(tmp_path / "mesh")
    policy = load_policy(str(tmp_path / "mesh.zip"), "Flag")
    seen, _ = env.reset(seed=0)
    batch = {name: part[None] for name, part in seen.items()}
    np.testing.assert_array_equal(policy(batch), model.predict(batch, deterministic=True)[0])
    with pytest.raises(ValueError, match=r"mesh.zip reads observations of shape .*these have \(128,\)"):
        policy(np.zeros((1, 128), np.float32))
    page = _page("Flag", str(tmp_path / "mesh.zip"), obs="mesh")  # beside the controller, which sees keypoints
    assert "| controller | miniature factor=4 |" in page


def test_materials_are_shown_to_whom_was_trained_on_them(tmp_path: Path) -> None:
    page = _page("Flag", "test_evaluate:of_materials", randomize={"drag": [0.2, 0.8]}, observe_material=True)
    assert "Both with resolution=(13, 17) randomize={'drag': [0.2, 0.8]} observe_material=True." in page
    with pytest.raises(AssertionError, match="129"):
        _page("Flag", "test_evaluate:of_materials", randomize={"drag": (0.2, 0.8)})


def of_materials(seen: np.ndarray) -> np.ndarray:
    assert seen.shape[1] == 129, "keypoints, a property, the task's numbers: 129"
    return np.zeros((len(seen), 2))


def _page(scene: str, policy: str, **options: Any) -> str:
    physics = ("miniature", {"factor": 4}), ("reference", {})
    return evaluate(
        policy, scene, train=physics[0], certify=physics[1], seeds=2, first_seed=0, beside="controller", out=None,
        frames=2, resolution=(13, 17), **options,
    )  # fmt: skip


def test_files_of_policies_that_cannot_act_are_refused_by_name(tmp_path: Path) -> None:
    torch = pytest.importorskip("torch", reason="needs the extra 'train'")
    path = tmp_path / "policy.pt"
    ours = {"mean": torch.zeros(5), "spread": torch.ones(5), "0.weight": torch.ones(2, 5), "0.bias": torch.zeros(2)}
    torch.save({name: value.requires_grad_() for name, value in ours.items()}, path)  # as of nn.Parameter
    assert load_policy(str(path), "Flag")(np.ones((1, 5))).tolist() == [[1, 1]]
    for wrong in ({"spread": torch.zeros(5)}, {"spread": torch.ones(4)}, {"spread": torch.full((5,), torch.nan)}):
        torch.save(ours | wrong, path)
        with pytest.raises(ValueError, match=r"policy.pt: mean and spread .* positive"):
            load_policy(str(path), "Flag")
    with zipfile.ZipFile(tmp_path / "lstm.zip", "w") as archive:
        archive.writestr("data", json.dumps({"policy_class": {"__module__": "sb3_contrib.common.recurrent.policies"}}))
    with pytest.raises(ValueError, match=r"lstm.zip is a model of sb3_contrib"):
        load_policy(str(tmp_path / "lstm.zip"), "Flag")


def test_rollouts_are_played_by_files_and_functions(tmp_path: Path) -> None:
    torch = pytest.importorskip("torch", reason="needs the extra 'train'")
    ours = {
        "mean": torch.zeros(128),
        "spread": torch.ones(128),
        "0.weight": torch.zeros(2, 128),
        "0.bias": torch.ones(2),
    }
    torch.save(ours, tmp_path / "full.pt")
    told = []
    for policy in (str(tmp_path / "full.pt"), "test_evaluate:full"):
        told.append(
            rollout(
                "Flag", frames=3, seed=0, policy=policy, video=None, images=None, hdf5=None, strain=False,
                overwrite=False, resolution=(13, 17),
            )
        )  # fmt: skip
    assert told[0] == told[1]
    env = gym.make(cloth_envs.env_id("Flag"), resolution=(13, 17))
    env.reset(seed=0)
    earned = np.mean([env.step(np.ones(2, np.float32))[1] for _ in range(3)])
    assert f"mean reward {earned:.3f}" in told[0]


def test_the_page(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    out = tmp_path / "page.md"
    words = ["evaluate", "random", "--scene", "Flag", "--train-backend", "cnn", "--seeds", "2", "--frames", "2"]
    assert main([*words, "--out", str(out)]) == 0
    text = capsys.readouterr().out
    assert out.read_text() in text
    assert "| random | 0.000 ± 0.000 |" in text
    assert "Trained on cnn, certified on reference: seeds 900000 to 900001 on both, episodes of 2 frames" in text
    assert "Nothing to beware of." in text
    assert "| 0% (< 78%) |" in text  # none of two: 1 - .05 ** (1/2)


def test_the_page_of_other_cloth(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["evaluate", "zero", "--scene", "Flag", "--train-backend", "cnn", "--seeds", "2", "--frames", "3"]
    pages = []
    for more in (
        [],
        ["--resolution", "13x17"],
        ["--material", "leather"],
        ["--randomize", '{"drag": [0.2, 0.8]}'],
        ["--preset", '{"name": "lee2019", "mass": 3}'],
        ["--obs", "mesh", "--beside", ""],
    ):
        assert main([*words, *more]) == 0
        pages.append(capsys.readouterr().out)
    assert len(set(pages[:5])) == 5
    assert pages[5].count("| zero |") == pages[0].count("| zero |")
    assert main([*words, "--randomize", "drag"]) == 2
    assert "--randomize must be JSON" in capsys.readouterr().err


def test_the_example_learns_and_its_policy_is_evaluated(tmp_path: Path) -> None:
    """On Pressure, the quickest; from 0.26 a frame, which actions around zero earn."""
    pytest.importorskip("torch", reason="needs the extra 'train'")
    path, policy = ROOT / "examples" / "train_ppo.py", tmp_path / "policy.pt"
    assert len(path.read_text().splitlines()) <= 150
    command = [sys.executable, str(path), "Pressure", "--frames", "48000", "--out", str(policy)]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    rewards = [float(reward) for reward in re.findall(r"([\d.]+) a frame", said)]
    assert "reference {}" in said
    assert len(rewards) == 13
    assert rewards[-1] > rewards[0] + 0.05
    seeds, options = range(4), {"backend": "miniature", "frames": 50}
    own, zero = (play("Pressure", load_policy(name, "Pressure"), seeds, **options) for name in (str(policy), "zero"))
    assert own.reward.mean() > zero.reward.mean() + 0.05
