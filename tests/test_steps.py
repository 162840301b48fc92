"""What the table of whole steps says: a step holds its backend, and the rest is what is outside."""

from __future__ import annotations

import pytest

from training.bench.steps import BATCHES, step_table, steps_of


@pytest.mark.parametrize("batch", BATCHES)
def test_a_step_is_more_than_what_is_outside_its_backend(batch: int) -> None:
    row = steps_of("Flag", "miniature", batch, 8)
    assert 0 < row.outside_us < row.step_us
    assert f"({row.outside_us:.1f}) us" in step_table([row])
