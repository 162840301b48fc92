"""The cheapest backend that holds a tolerance: a table that was measured, and what chooses and watches by it."""
