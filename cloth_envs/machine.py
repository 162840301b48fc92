"""What a measurement ran on."""

import os
import platform
from pathlib import Path

import _minicloth_kernels as kernels
import numpy as np

from cloth_envs.version import __version__


def processor() -> str:
    """The processor's name as the system tells it."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


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
