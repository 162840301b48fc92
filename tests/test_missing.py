"""Without an optional package, every way to it names the extra that brings it."""

from __future__ import annotations

import html
import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
# In a process of its own that finds none of ``BLOCKED``, as where they are not installed: what each line answers.
PROGRAM = """
import contextlib, importlib.machinery, io, json, sys

class Finder(importlib.machinery.PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        return None if name.split(".")[0] in BLOCKED else super().find_spec(name, path, target)

BLOCKED = set(sys.argv[1].split(","))
sys.meta_path[:] = [Finder if finder is importlib.machinery.PathFinder else finder for finder in sys.meta_path]
import gymnasium as gym
from cloth_envs.commands.cli import main

def command(*argv):
    printed = io.StringIO()
    with contextlib.redirect_stderr(printed):
        code = main(argv)
    return f"{code} {printed.getvalue()}"

def drawn(mode="rgb_array"):
    env = gym.make("MiniCloth-Flag-v0", render_mode=mode)
    env.reset()
    env.render()

def shown():
    env = gym.make("MiniCloth-Flag-v0", resolution=(9, 13)).unwrapped
    env.reset()
    return env._repr_html_()

def recorded():
    from cloth_envs.recording import RecordRollout, Rollout
    env = RecordRollout(gym.make("MiniCloth-Flag-v0", resolution=(9, 13)), "a.h5")
    env.reset(seed=0)
    env.close()
    with Rollout.open("a.h5") as rollout:
        return rollout._repr_html_()

answers = []
for line in json.loads(sys.argv[2]):
    try:
        answers.append(str(eval(line)))
    except Exception as error:
        answers.append(f"{type(error).__name__} {error}")
print(json.dumps(answers))
"""
BLOCKED = {"torch", "pyvista", "matplotlib", "imageio", "cholespy", "mujoco", "taichi", "stable_baselines3"}
LINES = {
    """gym.make("MiniCloth-Flag-v0", backend="cnn", backend_kwargs={"engine": "torch"})""": ("ImportError", "train"),
    """gym.make("MiniCloth-Flag-v0", backend="cnn", backend_kwargs={"device": "cuda"})""": ("ImportError", "gpu"),
    """gym.make("MiniCloth-Flag-v0", backend="miniature", backend_kwargs={"device": "cuda"})""": ("ImportError", "gpu"),
    """command("bench", "gpu", "--quick")""": ("2 minicloth: ", "train"),
    """gym.make("MiniCloth-Curtain-v0", backend="own_backend:Springs")""": ("ImportError", "train"),
    """gym.make("MiniCloth-Flag-v0", backend_kwargs={"solver": "implicit"}).reset()""": ("ImportError", "implicit"),
    """__import__("cloth_envs.stable_baselines")""": ("ImportError", "rl"),
    "drawn()": ("ImportError", "render"),
    """command("compare", "Flag")""": ("2 minicloth: ", "render"),
    """command("compare", "Curtain", "--backend", "own_backend:Springs")""": ("2 minicloth: ", "train"),
    """command("rollout", "Flag", "--video", "a.mp4")""": ("2 minicloth: ", "render"),
    """command("train", "local")""": ("2 minicloth: ", "train"),
    """command("train", "dynamics")""": ("2 minicloth: ", "train"),
    """command("train", "physics-cnn")""": ("2 minicloth: ", "train"),
    """command("train", "upscaler", "--recipe", "fc-flag-2")""": ("2 minicloth: ", "train"),
    """command("bench", "tables", "--quick")""": ("2 minicloth: ", "train"),
}


@pytest.fixture(scope="module")
def answers(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    program = f"import sys; sys.path[:0] = {[str(ROOT), str(ROOT / 'examples')]!r}\n{PROGRAM}"
    arguments = [",".join(sorted(BLOCKED)), json.dumps(list(LINES))]
    done = subprocess.run(
        [sys.executable, "-c", program, *arguments], cwd=tmp_path_factory.mktemp("here"), capture_output=True,
        text=True, check=True,
    )  # fmt: skip
    return dict(zip(LINES, json.loads(done.stdout.splitlines()[-1]), strict=True))


@pytest.mark.parametrize("line", LINES)
def test_what_is_missing_is_named_with_its_extra(line: str, answers: dict[str, str]) -> None:
    begin, extra = LINES[line]
    assert answers[line].startswith(begin)
    assert f'pip install -e ".[{extra}]"' in answers[line]
    assert answers[line].count("pip install") == 1


@pytest.mark.parametrize("package", ["matplotlib", "PIL"])
def test_what_pyvista_loads_later_is_named_too(package: str, tmp_path: Path) -> None:
    lines = [
        "drawn()",
        "drawn('depth_array')",
        """command("rollout", "Flag", "--images", "a")""",
        "shown()",
        "recorded()",
    ]
    begins = ["ImportError ", "ImportError ", "2 minicloth: ", "<div>no picture: ", "<div>no picture: "]
    if package == "PIL":  # which pictures in notebooks are written by
        lines, begins = lines[3:], begins[3:]
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, package, json.dumps(lines)], cwd=tmp_path, capture_output=True, text=True,
        check=True,
    )  # fmt: skip
    for line, answer, begin in zip(lines, json.loads(done.stdout.splitlines()[-1]), begins, strict=True):
        assert answer.startswith(begin), (line, answer)
        assert package in answer
        assert html.unescape(answer).count('pip install -e ".[render]"') == 1


def test_what_needs_none_of_them_works(tmp_path: Path) -> None:
    """Networks of the miniature are compiled: torch only trains them."""
    lines = ["""gym.make("MiniCloth-Flag-v0", backend="miniature").reset(seed=0)[1]""", """command("train")"""]
    arguments = [",".join(sorted(BLOCKED)), json.dumps(lines)]
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, *arguments], cwd=tmp_path, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert json.loads(done.stdout.splitlines()[-1]) == ["{}", "0 "]
    assert "physics-cnn" in done.stdout
