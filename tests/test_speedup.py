"""Speed-up at equal error, against a front worked out by hand."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from training.bench.speed_accuracy.rows import GATE, SpeedAccuracyRow
from training.bench.speed_accuracy.speedup import METHODS, speedups, table


def row(
    family: str, ms: float, error: float, *, options: str = "{}", gate: float = 0.0, floor: float = 0.0
) -> SpeedAccuracyRow:
    values = {f.name: np.nan for f in fields(SpeedAccuracyRow)}
    values |= {"scene": "Flag", "family": family, "options": options, "frames": 5, "windows": 1, "failure": ""}
    return SpeedAccuracyRow(**values | {"ms_median": ms, "error": error, "gate": gate, "floor": floor})  # type: ignore[arg-type]


BASELINES = [
    row("explicit", 8.0, 0.1),
    row("admm", 2.0, 1.6, options='{"iterations": 1}'),
    row("admm", 9.0, 0.4, options='{"iterations": 9}'),  # slower and less close than explicit: not on the front
    row("miniature similar", 1.0, 0.4, options='{"factor": 2}'),
    row("miniature rule", 0.75, 0.4, options='{"factor": 2}'),
    row("miniature calibrated", 0.5, 0.4, options='{"factor": 4}', gate=2 * GATE),
]
METHOD = row("miniature", 0.25, 0.4, options='{"factor": 4}')


def test_speedups_by_hand() -> None:
    found = {f.baselines: f for f in speedups([*BASELINES, METHOD]) if f.family == METHOD.family}
    # Solvers: explicit is the cheapest that is as close, 8 / 0.25. On logarithmic axes 0.4 lies halfway between 0.1 and
    # 1.6, so the line between explicit and admm is at sqrt(8 * 2) = 4 ms.
    assert (found["solvers"].beside, found["solvers"].speedup) == ("explicit", 32)
    assert found["solvers"].interpolated == pytest.approx(16)
    # The similar miniature is exactly as close, and so is, in less time, the tension field of the rule.
    assert (found["coarser grids"].beside, found["coarser grids"].speedup) == ("miniature similar x2", 4)
    for name in ("tension field", "fitted springs"):  # the calibrated one fails the gate
        assert (found[name].beside, found[name].speedup) == ("miniature rule x2", 3)
    assert "miniature x4" in table(list(found.values()))


def test_a_method_that_fails_the_gate_meets_baselines_that_do() -> None:
    failing = row("miniature", 0.25, 0.4, options='{"factor": 4}', gate=2 * GATE)
    found = {f.baselines: f for f in speedups([*BASELINES, failing]) if f.family == METHOD.family}
    assert (found["fitted springs"].beside, found["fitted springs"].speedup) == ("miniature calibrated x4", 2)
    assert found["fitted springs"].passes == 0


def test_limits() -> None:
    # A baseline is not compared with itself; one closer than all has no speed-up; below the chaos floor all are equal.
    found = [f for f in speedups([*BASELINES, METHOD]) if f.family == "miniature calibrated"]
    assert [f.baselines for f in found] == ["solvers", "coarser grids", "tension field"]
    (closest,) = (
        f for f in speedups([*BASELINES, row("cnn", 4.0, 0.01)]) if (f.family, f.baselines) == ("cnn", "solvers")
    )
    assert np.isnan(closest.speedup)
    assert np.isnan(closest.interpolated)
    floored = [row("explicit", 8.0, 0.1, floor=0.2), row("cnn", 4.0, 0.01, floor=0.2)]
    assert all(f.speedup == 2 for f in speedups(floored))
    assert METHOD.family in METHODS
    assert speedups([]) == []
