"""Every instruction set that the kernels are compiled for gives the twin's answer."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from _minicloth_kernels import instruction_set

SETS = ("baseline", "avx2", "avx512")


@pytest.mark.parametrize("name", SETS)
def test_kernels_agree_with_their_twins(name: str) -> None:
    if SETS.index(name) > SETS.index(instruction_set()):
        pytest.skip(f"this processor's best is {instruction_set()}")
    environment = {**os.environ, "MINICLOTH_INSTRUCTION_SET": name}
    check = "import _minicloth_kernels as k, pytest, sys; assert k.instruction_set() == sys.argv[1]; "
    check += "sys.exit(pytest.main(['-p', 'no:cacheprovider', *sys.argv[2:]]))"
    twins = [str(Path(__file__).with_name(f"test_{of}.py")) for of in ("kernel_twin", "particles", "upscale_twin")]
    done = subprocess.run([sys.executable, "-c", check, name, *twins], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
