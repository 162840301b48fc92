"""What needs training/ finds that of its own checkout, or says how to get one; extras say how to install them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from cloth_envs import extras
from cloth_envs.commands.cli import main

COMMANDS = [["bench", "throughput"], ["train", "local"], ["generate", "Flag"], ["report", "--out", "a.html"]]
COMMANDS += [["bench"], ["train"], ["generate"], ["report"]]


def test_training_is_found_beside_the_package(tmp_path: Path) -> None:
    """As after ``pip install -e``, which puts only the installed packages on the path."""
    program = (
        "import sys, cloth_envs; from cloth_envs.extras import CHECKOUT; from cloth_envs.commands.cli import main; "
        "sys.path[:] = [path for path in sys.path if path != str(CHECKOUT)]; main(['generate', 'Flag', '--help'])"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert "--preset" in done.stdout


@pytest.mark.parametrize("argv", COMMANDS)
def test_without_a_checkout_the_remedy_is_named(
    argv: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(extras, "in_checkout", lambda: False)
    assert main(argv) == 2
    assert "needs a checkout" in capsys.readouterr().err


@pytest.mark.parametrize("argv", COMMANDS)
def test_somebody_elses_training_is_not_taken_for_ours(
    argv: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    theirs = ModuleType("training")
    theirs.__file__ = "/elsewhere/training/__init__.py"
    monkeypatch.setitem(sys.modules, "training", theirs)
    assert main(argv) == 2
    assert "another package is called training (/elsewhere/training/__init__.py)" in capsys.readouterr().err


def test_install_lines_work_where_they_are_read(monkeypatch: pytest.MonkeyPatch) -> None:
    assert extras.install("render") == f'pip install -e ".[render]" in {Path(__file__).parents[1]}'
    monkeypatch.setattr(extras, "in_checkout", lambda: False)
    assert extras.install("usd") == 'pip install "minicloth[usd]"'


def test_the_implicit_solver_says_what_it_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    from cloth_envs.physics.implicit.prefactored import Prefactored

    monkeypatch.setitem(sys.modules, "cholespy", None)
    with pytest.raises(ImportError, match=r"needs cholespy .*\.\[implicit\]"):
        Prefactored(None, ())  # type: ignore[arg-type]
