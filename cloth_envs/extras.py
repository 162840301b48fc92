"""What may be missing: optional packages, by the line that installs them, and ``training``, which no wheel holds."""

import sys
from importlib import import_module
from pathlib import Path
from typing import Any

CHECKOUT = Path(__file__).resolve().parents[1]  # where this package lies in a checkout; site-packages elsewhere


def in_checkout() -> bool:
    """Whether the package is used from a checkout of its repository."""
    project = CHECKOUT / "pyproject.toml"
    return project.is_file() and 'name = "minicloth"' in project.read_text(encoding="utf-8")


# package as it is imported -> the extra that brings it
EXTRAS = {
    "PIL": "render",
    "cholespy": "implicit",
    "cupy": "gpu",
    "imageio": "render",
    "imageio_ffmpeg": "render",
    "matplotlib": "render",
    "moviepy": "render",
    "mujoco": "peers",
    "pyvista": "render",
    "stable_baselines3": "rl",
    "taichi": "peers",
    "torch": "train",
    "vtkmodules": "render",
}


def install(extra: str) -> str:
    """The command that brings the optional dependencies ``extra``.

    The package is on no index: a checkout is installed again; an installed wheel satisfies pip, which adds the extra's.
    """
    return f'pip install -e ".[{extra}]" in {CHECKOUT}' if in_checkout() else f'pip install "minicloth[{extra}]"'


def missing(what: str, error: ImportError, extra: str | None = None) -> str:
    """What ``what`` lacks, and the line that installs it if that is one of ``EXTRAS``; else what ``error`` says.

    ``extra`` is to be installed in place of the one that the package has there.
    """
    package = (error.name or "").split(".")[0] if isinstance(error, ModuleNotFoundError) else ""
    extra = (extra or EXTRAS[package]) if package in EXTRAS else None
    return f"{what} needs {package} ({error}): {install(extra)}" if extra else str(error)


def load(name: str) -> Any:
    """What ``"module:attribute"`` of ``training`` names. Raises ImportError: no checkout here, or another training."""
    module, attribute = name.split(":")
    if not in_checkout():
        raise ImportError(
            "this command needs a checkout, since the folder training/ is not part of the installed package: "
            'git clone the repository of MiniCloth and run pip install -e ".[train]" in it'
        )
    if str(CHECKOUT) not in sys.path:
        sys.path.insert(0, str(CHECKOUT))
    found = import_module("training").__file__
    if found != str(CHECKOUT / "training" / "__init__.py"):
        raise ImportError(
            f"another package is called training ({found}) and was imported before the one of {CHECKOUT}: "
            f"start minicloth in {CHECKOUT}, or take the other out of PYTHONPATH"
        )
    return getattr(import_module(module), attribute)
