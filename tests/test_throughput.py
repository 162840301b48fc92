"""``minicloth bench throughput``: kernels of every instruction set side by side, and what their times come to."""

import os

import pytest

from training.bench import levels
from training.bench.throughput import kernel
from training.bench.throughput.rows import SIZES, table
from training.bench.throughput.terms import BENDING, DEFAULT, SPRINGS, TERMS


def test_a_process_has_the_instruction_set_and_leaves_this_one_alone() -> None:
    assert levels.levels()[0] == "baseline"
    before = dict(os.environ)
    with levels.process("baseline") as pool:
        assert pool.submit(levels.levels).result() == ["baseline"]
    assert dict(os.environ) == before
    with pytest.raises(RuntimeError, match="where avx1024 was asked for"), levels.process("avx1024"):
        pass


def test_slow_forces_count_as_often_as_they_are_computed() -> None:
    term = TERMS[DEFAULT]
    assert term.work(1).operations - term.work(7).operations == pytest.approx(6 / 7 * (BENDING.operations + 6))
    assert TERMS["springs"].work(7) == SPRINGS
    for what in TERMS.values():  # two operations an instruction at most
        assert 1 <= what.work(7).operations / what.work(7).instructions <= 2


def test_shares_follow_from_the_best_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernel, "peak_flops", lambda level: 1e12)
    monkeypatch.setattr(kernel, "nominal_hz", lambda: 2e9)
    chosen = [kernel.Job(dtype, "Flag", "springs", 1, 1, 1) for dtype in ("float32", "float64")]
    (single, double), peak = kernel.measure_level("baseline", chosen)
    assert peak == 1e12
    assert 0 < single.ns_best <= single.ns_median
    assert single.cycles == pytest.approx(single.ns_best * 2 * 4)
    assert double.cycles == pytest.approx(double.ns_best * 2 * 2)
    assert single.of_peak == single.of_limit == pytest.approx(SPRINGS.operations / single.ns_best / 1e3)
    assert double.of_peak != double.of_peak  # not counted
    text = table([single, double])
    assert f"Flag ({SIZES['Flag'].vertices})" in text
    assert f"{single.ns_median:.2f} ({single.ns_best:.2f})" in text
