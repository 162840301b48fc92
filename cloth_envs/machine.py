"""What a measurement ran on."""

import os
import platform
from pathlib import Path

import _minicloth_kernels as kernels
import numpy as np

from cloth_envs.version import __version__


def _told(what: str) -> str:
    """What the system tells of the first processor, or nothing."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith(what)), "")


def processor() -> str:
    """The processor's name as the system tells it."""
    return _told("model name") or platform.processor() or platform.machine()


def nominal_hz() -> float:
    """The processor's clock as the system tells it [1/s], NaN where it does not; it may run faster or slower."""
    return 1e6 * float(_told("cpu MHz") or "nan")


def header() -> dict[str, object]:
    """Machine and versions, for the top of measured rows."""
    return {
        "processor": processor(),
        "cores": os.cpu_count(),
        "instruction_set": kernels.instruction_set(),
        "platform": platform.platform(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "minicloth": __version__,
    }
