"""Backends from outside: registered, installed or named by module, they work wherever a backend is named."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import cloth_envs
from cloth_envs.backend import parse_backend
from cloth_envs.commands.cli import main
from cloth_envs.naming import resolve
from cloth_envs.physics.explicit.solver import ExplicitSolver
from cloth_envs.registry import backend_names, load_backend, register_backend
from cloth_envs.scene import Scene
from training.bench.participants import extra

SOURCE = """
from cloth_envs.physics.explicit.solver import ExplicitSolver

class Finer(ExplicitSolver):
    "The reference, of another name and without threads."

    def __init__(self, scene, *, num_envs=1, refine=1):
        super().__init__(scene, num_envs=num_envs, refine=refine)

def no_batch(scene):
    return Finer(scene)
"""


@pytest.fixture(autouse=True)
def registry(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """A table of backends that is put back."""
    table = dict(cloth_envs.BACKENDS)
    monkeypatch.setattr("cloth_envs.registry.BACKENDS", table)
    return table


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A distribution ``their-cloth`` that is installed in a folder of the path."""
    (tmp_path / "their_cloth.py").write_text(SOURCE)
    install(tmp_path, "their-cloth", "finer = their_cloth:Finer\nbroken = their_cloth:Coarser\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "their_cloth", raising=False)
    return tmp_path


def install(folder: Path, name: str, points: str) -> None:
    about = folder / f"{name.replace('-', '_')}-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(f"[minicloth.backends]\n{points}")


def stepped(backend: str, **kwargs: Any) -> np.ndarray:
    env = gym.make("MiniCloth-Flag-v0", resolution=(9, 13), backend=backend, backend_kwargs=kwargs)
    env.reset(seed=3)
    for _ in range(3):
        env.step(np.ones(env.action_space.shape or (), np.float32))
    return env.unwrapped.state.positions  # type: ignore[attr-defined]


def test_a_name_a_module_and_an_installed_package_are_the_same_backend(package: Path) -> None:
    register_backend("mine", resolve("their_cloth:Finer"))
    register_backend("lazy", "their_cloth:Finer")
    wanted = stepped("reference", refine=2)
    for name in ("mine", "lazy", "finer", "their_cloth:Finer"):
        np.testing.assert_array_equal(stepped(name, refine=2), wanted)
    assert {"reference", "mine", "lazy", "finer"} <= set(backend_names())


@pytest.mark.parametrize(("backend", "kwargs"), [("finer", {}), ("reference", {"solver": "implicit"})])
def test_vector_environments_pass_threads_only_where_they_are_taken(
    package: Path, backend: str, kwargs: dict[str, Any]
) -> None:
    env = gym.make_vec("MiniCloth-Hanging-v0", num_envs=2, resolution=(5, 5), backend=backend, backend_kwargs=kwargs)
    env.reset(seed=0)
    env.step(np.zeros(env.action_space.shape or (), np.float32))


def test_commands_take_them(package: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["rollout", "Flag", "--frames", "2", "--resolution", "9x13", "--backend", 'finer={"refine": 2}']) == 0
    options = ["--frames", "2", "--resolutions", "9x13", "--no-video", "--out", str(tmp_path / "out")]
    backends = ["--backend", "their_cloth:Finer", "--backend", 'finer@5x7={"refine": 2}']
    assert main(["compare", "Flag", *options, *backends]) == 0
    assert main(["list"]) == 0
    text = capsys.readouterr().out
    for words in ("their_cloth:Finer 9x13", "finer 5x7 refine=2", "of another name and without threads"):
        assert words in text
    assert "broken" in text  # and why, instead of no list at all
    assert "their-cloth" in text


@pytest.mark.parametrize(
    ("name", "error", "words"),
    [
        ("fine", ValueError, "Did you mean 'finer'"),
        ("their_cloths:Finer", ValueError, "no module 'their_cloths'.*PYTHONPATH"),
        ("their_cloth:Fine", ValueError, "module 'their_cloth'.*Did you mean 'Finer'"),
        ("their_cloth:", ValueError, "module:attribute"),
        ("their_cloth:no_batch", ValueError, r"\(scene, \*, num_envs, \*\*options\).*num_envs"),
        ("broken", ImportError, "their-cloth.*Coarser.*uninstall"),
        (3, ValueError, "register_backend"),
    ],
)
def test_mistakes_name_the_remedy(package: Path, name: Any, error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        load_backend(name)


@pytest.mark.parametrize(
    ("source", "words"),
    [("import not_installed_anywhere", "not_installed_anywhere"), ("1 / 0", "ZeroDivisionError"), ("(", "SyntaxError")],
)
def test_a_module_that_cannot_be_imported_says_why(package: Path, source: str, words: str) -> None:
    (package / "needy.py").write_text(source)
    with pytest.raises(ImportError, match=f"'needy:Backend' can't be imported.*{words}.*repair"):
        load_backend("needy:Backend")


@pytest.mark.parametrize(
    ("factory", "options", "words"),
    [
        (lambda scene, *, num_envs=1: None, {}, "without reset, advance"),
        (lambda scene, *, num_envs=1, **more: ExplicitSolver(scene, **more), {"gian": 2}, "can't be built.*gian"),
        (ExplicitSolver, "refine", "must be a dict"),
    ],
)
@pytest.mark.parametrize("make", [gym.make, gym.make_vec])
def test_a_factory_that_makes_no_backend_is_refused(make: Any, factory: Any, options: Any, words: str) -> None:
    register_backend("odd", factory)
    with pytest.raises(ValueError, match=words):
        make("MiniCloth-Flag-v0", backend="odd", backend_kwargs=options)


@pytest.mark.parametrize("name", ["thrid", 3, "their_cloth:Finer", "their_cloth:no_batch"])
def test_a_wrong_upscaler_is_refused(package: Path, name: Any) -> None:
    with pytest.raises(ValueError, match="upscaler"):
        gym.make("MiniCloth-Flag-v0", backend="miniature", backend_kwargs={"upscaler": name})


@pytest.mark.parametrize("text", ["{", "nosuch", "their_cloth:Fine", 'finer={"gian": 2}'])
def test_a_benchmark_refuses_a_wrong_backend_before_it_measures(package: Path, text: str) -> None:
    with pytest.raises(ValueError, match=r"Choose one of|attribute"):
        extra([text])


def test_two_packages_with_one_name_are_told_apart(package: Path) -> None:
    install(package, "other-cloth", "finer = their_cloth:no_batch\n")
    with pytest.raises(ValueError, match=r"other-cloth, their-cloth.*their_cloth:Finer or their_cloth:no_batch"):
        load_backend("finer")
    assert load_backend("their_cloth:Finer")


def test_registering_replaces_only_when_told(registry: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="overwrite=True"):
        register_backend("reference", ExplicitSolver)
    register_backend("reference", ExplicitSolver, overwrite=True)
    assert registry["reference"] is load_backend("reference") is ExplicitSolver

    def no_batch(scene: Scene) -> Any:
        return scene

    for name, factory, words in (
        ("a:b", ExplicitSolver, "without ':'"),
        ("", ExplicitSolver, "without ':'"),
        ("mine", no_batch, "num_envs"),
        ("mine", 3, "class or function"),
    ):
        with pytest.raises(ValueError, match=words):
            register_backend(name, factory)  # type: ignore[arg-type]
    assert "mine" not in registry


def test_a_backend_in_a_line() -> None:
    assert parse_backend("reference") == ("reference", {})
    assert parse_backend('miniature={"factor": 4, "guard": true}') == ("miniature", {"factor": 4, "guard": True})
    assert parse_backend('package.file:Name={"a": "b=c:d@e"}') == ("package.file:Name", {"a": "b=c:d@e"})
    with pytest.raises(ValueError, match="JSON"):
        parse_backend("reference=refine")
