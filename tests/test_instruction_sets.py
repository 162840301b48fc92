"""Every instruction set that the kernels are compiled for gives the twins' answers, in every kernel."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from _minicloth_kernels import instruction_set

SETS = ("baseline", "avx2", "avx512")
TESTS = Path(__file__).parent
KERNELS = TESTS.parent / "cloth_envs/physics/kernels"
# What holds the loops of each file to NumPy.
TWINS = {
    "admm/lanes": "test_admm.py::test_steps_equal_the_twin",
    "episode/lanes": "test_diagnostics.py::test_the_compiled_check_is_the_largest_strain_and_the_energy",
    "explicit/lanes": "test_kernel_twin.py",
    "implicit/lanes": "test_implicit.py::test_the_gradient_is_the_twins_forces",
    "nets/correct_lanes": "test_dynamics.py::test_the_compiled_correction_of_a_frame_is_its_numpy_twin",
    "nets/detail_lanes": "test_superres.py::test_the_kernel_is_its_twin",
    "nets/patch_lanes": "test_upscale_twin.py::test_the_residual_is_that_of_the_twin",
    "nets/resample_lanes": "test_miniature.py::test_interpolation_is_exact_for_its_degree_and_at_shared_vertices",
    "particles/lanes": "test_particles.py",
    "projection/meet_lanes": "test_separation.py::test_folds_do_not_cross_where_the_coarse_ones_do_not",
    "projection/mend_lanes": "test_mending.py::test_the_kernel_is_its_twin",
    "projection/lanes": "test_upscale_twin.py::test_vertices_are_put_on_the_surface_and_stop_there",
    "selfcontact/lanes": "laws/test_layers.py",
}


def test_every_kernel_has_a_twin() -> None:
    assert {path.relative_to(KERNELS).with_suffix("").as_posix() for path in KERNELS.glob("*/*lanes.cpp")} == set(TWINS)


@pytest.mark.parametrize("name", SETS)
def test_kernels_agree_with_their_twins(name: str) -> None:
    if SETS.index(name) > SETS.index(instruction_set()):
        pytest.skip(f"this processor's best is {instruction_set()}")
    environment = {**os.environ, "MINICLOTH_INSTRUCTION_SET": name}
    check = "import _minicloth_kernels as k, pytest, sys; assert k.instruction_set() == sys.argv[1]; "
    check += "sys.exit(pytest.main(['-p', 'no:cacheprovider', *sys.argv[2:]]))"
    twins = [str(TESTS / twin) for twin in TWINS.values()]
    done = subprocess.run([sys.executable, "-c", check, name, *twins], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
