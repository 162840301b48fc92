"""Commands that take long say first what they do and where it goes; those without a name list their names."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from cloth_envs.commands.cli import main
from cloth_envs.progress import progress
from surrogates.checkpoint import WEIGHTS, load
from training import TRAININGS
from training.bench.benchmark import BENCHMARKS, Benchmark, Session
from training.generate import Plan, draw, generate, task_of


@pytest.mark.parametrize(
    ("command", "names"),
    [("bench", [*BENCHMARKS, "all"]), ("train", list(TRAININGS)), ("generate", ["Curtain", "Flag", "Collision"])],
)
def test_without_a_name_the_names_are_listed(
    command: str, names: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([command]) == 0
    head, *lines = capsys.readouterr().out.splitlines()
    assert head.startswith(f"usage: minicloth {command} ")
    assert [line.split()[0] for line in lines] == names
    assert all(len(line.split()) > 2 for line in lines)  # each says what it is


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["rolout", "Flag"], "Did you mean 'rollout'?"),
        (["rollout", "Flag", "--polcy", "random"], "unknown option '--polcy'. Did you mean '--policy'?"),
        (["compare", "Flag", "--resolution=9x13", "--novideo"], "Did you mean '--no-video'?"),
        (["bench", "throughput", "--quik"], "Did you mean '--quick'?"),
        (["train", "physics-cnn", "--scene-s", "Flag"], "Did you mean '--scenes'?"),
        (["generate", "Flag", "--trajectorys", "3"], "Did you mean '--trajectories'?"),
    ],
)
def test_unknown_options_name_the_nearest(argv: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(argv)
    out, err = capsys.readouterr()
    assert out == ""
    assert words in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["rollout", "Flag", "--backend", "toy@3x3"], "belongs to minicloth compare.*--backend toy.*--resolution 3x3"),
        (["bench", "mesh", "--backend", "toy@3x3"], "belongs to minicloth compare"),
        (["report"], "write minicloth report --out OUT.html"),
        (["train", "locl"], "Did you mean 'local'"),
    ],
)
def test_mistakes_are_answered_by_what_to_write(
    argv: list[str], words: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(argv) == 2
    assert re.search(words, capsys.readouterr().err.splitlines()[-1])


def test_generate_says_how_much_and_where(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    folder = tmp_path / "minicloth" / "pairs" / "lee2019" / "flag"
    generate(Plan("Flag", frames=5), folder, 1)
    capsys.readouterr()
    with pytest.raises(SystemExit, match="0"):
        main(["generate", "Flag", "--trajectories", "2", "--frames", "5"])
    out, err = capsys.readouterr()
    plan, goes_on, done = err.splitlines()
    for word in ("Flag", "2 trajectories of 5 frames", "1 of them there already", "14,570 pairs", "MB", str(folder)):
        assert word in plan
    assert "goes on" in goes_on
    assert done.startswith("Flag, new trajectories: 1 of 1")
    assert f"{folder}: 1 new of 2 trajectories" in out


def test_the_plans_megabytes_are_those_on_disk(tmp_path: Path) -> None:
    plan = Plan("Flag", frames=10)
    generate(plan, tmp_path, 1)
    size = (tmp_path / "00000.h5").stat().st_size
    told = plan.size(task_of("Flag", "lee2019", draw(plan, 0)).scene.grid)
    assert told <= size < told + 25_000  # HDF5's own headers, and checksums


def test_rollout_render_and_compare_say_where(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["rollout", "Flag", "--frames", "2", "--resolution", "9x13", "--hdf5", "a.h5"]) == 0
    plan, *_, done = capsys.readouterr().err.splitlines()
    assert plan == "Flag: 2 frames of 40 ms, 9 x 13 vertices, into a.h5"
    assert done.startswith("Flag: 2 of 2 frames")
    monkeypatch.setattr("cloth_envs.commands.rollout.write_pictures", lambda *_, **__: None)
    assert main(["render", "a.h5", "--images", "pictures"]) == 0
    assert capsys.readouterr().err.splitlines()[0] == "a.h5: 3 pictures of Flag into pictures"
    assert main(["compare", "Flag", "--frames", "1", "--resolutions", "9x13", "--no-video"]) == 0
    plan = capsys.readouterr().err.splitlines()[0]
    assert "reference 9x13" in plan
    assert "compare_flag" in plan


def test_benchmarks_say_what_is_kept_and_where(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    def measure(session: Session) -> None:
        list(progress(session.scenes, "scenes"))

    bench = Benchmark("tiny", "How tiny.", files={}, parts=[], measure=measure, scenes=("Flag",))
    assert bench.main(["--cache", str(tmp_path / "cache")]) == 0
    err = capsys.readouterr().err
    for word in ("tiny", "How tiny.", "Scenes Flag", "--out FOLDER keeps them", str(tmp_path / "cache")):
        assert word in err
    assert "scenes: 1 of 1" in err
    assert bench.main(["--out", str(tmp_path / "rows")]) == 0
    assert f"rows go into {tmp_path / 'rows'}, where 0 rows" in capsys.readouterr().err


def test_training_leaves_the_packages_weights_alone(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    before = {path: path.stat().st_mtime_ns for path in WEIGHTS.iterdir()}
    with pytest.raises(SystemExit, match="0"):
        main(["train", "physics-cnn", "--no-particles", "--scenes", "Flag"])
    out, err = capsys.readouterr()
    assert "Weights go into weights" in err
    assert "wrote weights/cnn_flag.safetensors" in out
    assert load("cnn_flag", Path("weights")).arrays.keys() == load("cnn_flag").arrays.keys()
    assert {path: path.stat().st_mtime_ns for path in WEIGHTS.iterdir()} == before
