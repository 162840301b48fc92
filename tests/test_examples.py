"""The examples run."""

from __future__ import annotations

import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import imageio.v2 as imageio
import pytest

ROOT = Path(__file__).parents[1]


def test_quickstart_runs(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, str(ROOT / "examples" / "quickstart.py"), str(tmp_path)],
        capture_output=True,
        text=True,
        check=True,
    )
    assert "51 frames recorded" in done.stdout
    assert imageio.imread(tmp_path / "flag.png").shape == (480, 640, 3)
    assert len((ROOT / "examples" / "quickstart.py").read_text().splitlines()) <= 40


def test_gallery_runs(tmp_path: Path) -> None:
    command = [sys.executable, str(ROOT / "examples" / "gallery.py"), "--starts", "--out", str(tmp_path / "all.png")]
    subprocess.run(command, capture_output=True, check=True)
    sheet = imageio.imread(tmp_path / "all.png")
    assert sheet.shape == (900, 1200, 3)
    for tile in (sheet[:300, i : i + 400] for i in (0, 400, 800)):
        assert tile.std() > 10  # something is drawn in each


def run_example(name: str, *arguments: str) -> str:
    path = ROOT / "examples" / f"{name}.py"
    assert len(path.read_text().splitlines()) <= 80
    command = [sys.executable, str(path), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def test_forces_plug_into_the_cell() -> None:
    drop, lift, free, slowed = (float(n) for n in re.findall(r"(-?[\d.]+) m", run_example("cnn_forces")))
    assert drop < -10 < 0 < lift  # mm; g t^2 / 2 = 18 mm
    assert free == pytest.approx(9.81 * 0.2, abs=0.01)
    # v' = g - 4 v^2 gives 1.57 tanh(g t / 1.57) = 1.33 m/s; the network is a rough one.
    assert slowed == pytest.approx(1.33, abs=0.15)


def test_gradients_go_through_ten_frames() -> None:
    said = run_example("cnn_gradient")
    # The solver's steps are longer than the cell's here: half a percent.
    assert float(re.search(r"on: ([\d.]+) N/m", said)[1]) == pytest.approx(20, rel=0.01)
    assert float(re.search(r"by ([\d.]+) mm", said)[1]) < 0.01  # Newton's method doubles its digits in every step


def test_an_upscaler_goes_on_top_of_the_cell() -> None:
    # Coarse physics errs by about as much: 4 to 9 mm on a curtain after five frames (docs/surrogates.md).
    assert float(re.search(r"([\d.]+) mm off", run_example("cnn_upscaler"))[1]) < 15


def test_rewards_are_compared_in_pairs(monkeypatch: pytest.MonkeyPatch) -> None:
    mean, error, frame = (
        float(n) for n in re.findall(r"[+-]?\d\.\d{4}", run_example("fidelity", "--pairs", "3", "--frames", "20"))
    )
    assert error > 0
    assert 0 < abs(mean) <= frame < 0.3
    monkeypatch.syspath_prepend(ROOT / "examples")
    gaps = import_module("fidelity").gaps
    assert (gaps("Flag", "cnn", {}, pairs=2, frames=8) == 0).all()  # it is the reference to the bit
    assert (gaps("Flag", "miniature", {}, pairs=2, frames=8)[-1] != 0).all()


def test_a_stiffer_disc_has_the_larger_drape_coefficient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT / "examples")
    drape = import_module("cusick").drape
    limp, stiff, flat = drape("silk", 13, 0.3)[0], drape("leather", 13, 0.3)[0], drape("silk", 13, 0.0)[0]
    assert flat == pytest.approx(100, abs=6)  # nothing has moved yet; the disc is cut along cells of 2.5 cm
    assert 20 < limp < stiff - 10
