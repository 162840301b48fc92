"""``minicloth bench long-runs``: what is told of made-up episodes is what was put in, and it works end to end."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cloth_envs.world import World
from training.bench.benchmark import find
from training.bench.long_runs import run
from training.bench.long_runs.chart import ratios, styles
from training.bench.long_runs.episodes import Episodes, names, watch
from training.bench.long_runs.rows import FINE, LongRow, SpectrumRow, compare, spectra, summary
from training.bench.participants import NUDGED
from training.metrics.spectra import BANDS
from training.rollouts import seeded_actions
from training.rows import read_rows

NAMES = ["still", "slow", "goal"]
KEY = ("Flag", "mine", "{}", "smooth")


def made(seed: int, episodes: int = 4) -> Episodes:
    """Two components that the cloth decides, the first hardly moving, and one that it does not."""
    rng = np.random.default_rng(seed)
    observed = rng.normal(size=(50, episodes, 3)) * [1e-7, 2.0, 0.0] + [0.0, 0.0, 0.7]
    terms = {name: 5 + rng.normal(size=(50, episodes)) for name in ("height", "bending", "kinetic", "strain")}
    return Episodes(
        np.zeros(episodes, bool), np.full((60, episodes), 0.5), observed, terms, np.ones((BANDS, episodes)),
        np.ones((BANDS, episodes)),
    )  # fmt: skip


def told(one: Episodes, truth: Episodes, nudged: Episodes) -> LongRow:
    return compare(KEY, one, truth, nudged, NAMES, 1.0)


TRUTH, OTHER = made(0), made(1)


def test_a_run_like_the_reference_is_at_no_distance() -> None:
    row = told(TRUTH, TRUTH, OTHER)
    assert [row.observed, row.height, row.height_apart, row.kinetic_apart, row.reward, row.space, row.time] == [0] * 7
    assert [row.bending, row.kinetic, row.strain] == [1] * 3
    assert told(OTHER, TRUTH, OTHER).fresh == 1


def test_each_statistic_tells_its_own_change() -> None:
    shift = TRUTH.observed + np.array([0.002, 0.0, 5.0])  # twice ``STILL`` of a metre; goals are not the cloth's
    row = told(replace(TRUTH, observed=shift), TRUTH, OTHER)
    assert (row.observed, row.observed_worst, row.worst) == (
        pytest.approx(1, rel=1e-3),
        pytest.approx(2, rel=1e-3),
        "still",
    )
    assert row.kinetic == 1
    deviation = np.concatenate([TRUTH.observed, OTHER.observed])[..., 1].std()
    far = told(replace(TRUTH, observed=TRUTH.observed + np.array([0.0, 3 * deviation, 0.0])), TRUTH, OTHER)
    assert (far.observed_worst, far.worst) == (pytest.approx(3, rel=1e-4), "slow")
    assert far.fresh > 2

    kinetic, height = TRUTH.terms["kinetic"], TRUTH.terms["height"]
    row = told(replace(TRUTH, terms={**TRUTH.terms, "kinetic": kinetic / 2}), TRUTH, OTHER)
    assert (row.kinetic, row.bending, row.observed) == (0.5, 1, 0)
    assert row.kinetic_apart == pytest.approx(kinetic.mean() / 2 / kinetic.std(), rel=1e-4)
    row = told(replace(TRUTH, terms={**TRUTH.terms, "height": height - 2 * height.std()}), TRUTH, OTHER)
    assert [row.height, row.height_apart] == pytest.approx([-2, 2], rel=1e-4)

    gains = np.array([0.01, 0.03, 0.01, 0.03])  # their deviation is 0.02 / sqrt(3), of four episodes half of it counts
    row = told(replace(TRUTH, rewards=TRUTH.rewards + gains), TRUTH, OTHER)
    assert (row.reward, row.reward_error) == (pytest.approx(0.02), pytest.approx(0.01 / np.sqrt(3), rel=1e-4))

    space = TRUTH.space * np.where(np.arange(BANDS) < FINE, 1000.0, 0.1)[:, None]  # of coarse folds nothing is told
    row = told(replace(TRUTH, space=space, time=100 * TRUTH.time), TRUTH, OTHER)
    assert (row.space, row.time) == (pytest.approx(10), pytest.approx(20))


def test_episodes_that_ended_are_left_out() -> None:
    bad = TRUTH.observed.copy()
    bad[:, 1] = 99.0
    row = told(replace(TRUTH, observed=bad, ended=np.array([False, True, False, False])), TRUTH, OTHER)
    assert (row.episodes, row.ended, row.observed) == (3, 1, 0)
    none = replace(TRUTH, ended=np.ones(4, bool))
    row = told(none, TRUTH, OTHER)
    assert (row.episodes, row.ended, row.worst) == (0, 4, "")
    assert np.isnan(row.observed)
    assert spectra(KEY, none, 0.02) == []


def test_episodes_of_the_reference() -> None:
    """It repeats itself bit for bit, a nudge spreads, and observations that are of actions alone stay as they were."""
    world, seeds = World("Collision", num_envs=2), (900, 901)
    actions = seeded_actions(world, seeds, ["bang-bang"], 60)
    first, again = (watch(world, actions, seeds, 20) for _ in range(2))
    other = watch(world, actions, seeds, 20, nudged=True)
    np.testing.assert_array_equal(first.observed, again.observed)
    assert first.observed.shape == (40, 2, len(names(world)))
    assert first.rewards.shape == (60, 2)
    assert {name: values.shape for name, values in first.terms.items()} == {
        "height": (40, 2), "kinetic": (40, 2), "bending": (8, 2), "strain": (8, 2),
    }  # fmt: skip
    alike = dict(zip(names(world), (first.observed == other.observed).all((0, 1)), strict=True))
    assert alike["goal x"]
    assert alike["ball z"]
    assert not alike["x 9"]
    row = compare(("Collision", "", "", ""), other, first, other, names(world), world.scene.grid.length)
    assert 0 < row.observed < 0.5
    assert row.fresh == 1


def test_charts_have_a_colour_a_method_and_ratios_in_decibel() -> None:
    looks = styles(["mini \u00d72", "mini \u00d74", "similar \u00d74"])
    assert looks["mini \u00d72"]["color"] == looks["mini \u00d74"]["color"] != looks["similar \u00d74"]["color"]
    assert looks["mini \u00d72"]["ls"] == looks["similar \u00d74"]["ls"] != looks["mini \u00d74"]["ls"]
    rows = [
        SpectrumRow("Flag", name, "{}", actions, "time", 1.5, power)
        for name, powers in (("reference", (1.0, 10.0)), ("mine", (100.0, 10.0)))
        for actions, power in zip(("smooth", "random"), powers, strict=True)
    ]
    ((at, power),) = ratios(rows, "Flag", "time").values()
    assert (at.tolist(), power.tolist()) == ([1.5], [10.0])


def test_quick_run_end_to_end_and_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run, "ACTIONS", ("bang-bang",))
    argv = ["--quick", "--scenes", "Collision", "--backend", 'reference={"refine": 2}', "--out", str(tmp_path)]
    assert find("long-runs").main(argv) == 0
    assert "QUICK" in capsys.readouterr().out
    rows = {row.backend: row for row in read_rows(tmp_path / "long_runs.csv", LongRow)}
    assert all(row.episodes == 2 for row in rows.values())
    assert rows["reference refine=2"].time < rows["mini \u00d74"].time
    assert rows["mini \u00d74"].space < rows["calibrated \u00d74"].space  # bicubic cloth has no fine folds
    line = next(line for line in summary(list(rows.values())).splitlines() if NUDGED in line)
    assert line.split()[3:5] == ["1.00", "1.00"]
    kept = {path.name: path.read_text() for path in tmp_path.glob("*.csv")}
    (tmp_path / "long_runs.png").unlink()
    assert find("long-runs").main(argv) == 0
    assert {path.name: path.read_text() for path in tmp_path.glob("*.csv")} == kept
    assert (tmp_path / "long_runs.png").stat().st_size > 10_000
