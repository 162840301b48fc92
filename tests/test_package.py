"""Importing is light, and imports go one way."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

from cloth_envs import __version__

HEAVY = ("torch", "pyvista", "vtk", "scipy", "matplotlib", "h5py", "surrogates", "training")
ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "cloth_envs"


def test_import_loads_nothing_heavy() -> None:
    code = f"import sys, cloth_envs, cloth_envs.env; print([m for m in {HEAVY} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_making_and_stepping_loads_no_torch_and_no_renderer() -> None:
    code = (
        "import sys, gymnasium as gym, cloth_envs; e = gym.make('cloth_envs:MiniCloth-Flag-v0'); e.reset(seed=0); "
        f"e.step(e.action_space.sample()); print([m for m in {HEAVY} if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_cloth_envs_imports_no_surrogate_and_no_training() -> None:
    pattern = re.compile(r"^\s*(?:from|import) (?:surrogates|training)", re.M)
    found = [
        str(path.relative_to(PACKAGE))
        for path in PACKAGE.rglob("*.py")
        if pattern.search(path.read_text()) and "commands" not in path.parts and path.name != "cli.py"
    ]
    assert found == []


def test_scenes_name_no_solver() -> None:
    for path in [*(PACKAGE / "scenes").glob("*.py"), PACKAGE / "scene.py"]:
        if path.name != "compiled.py":  # the one door from scenes to compiled code, and to nothing of a solver's
            assert not re.search(r"explicit|admm|implicit|substep|kernel", path.read_text()), path.name


def test_one_version_and_one_licence() -> None:
    project, citation = ((ROOT / name).read_text(encoding="utf-8") for name in ("pyproject.toml", "CITATION.cff"))
    for name in ("version", "license"):
        told = [re.findall(rf'^{name}(?: =|:) "?([\w.]+)"?$', text, re.M) for text in (project, citation)]
        assert told[0] == told[1]
        assert len(told[0]) == 1
    assert f'version = "{__version__}"' in project


def test_both_packages_are_typed() -> None:
    assert [(ROOT / name / "py.typed").is_file() for name in ("cloth_envs", "surrogates")] == [True, True]
