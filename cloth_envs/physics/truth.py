"""What a result is held against: the explicit solver at named refinements of its stable step, same mesh and energy."""

from typing import Any

# name -> options of the reference backend. `refine` divides the largest stable step.
TRUTHS: dict[str, dict[str, Any]] = {
    "plain": {"dtype": "float64"},  # the solver as it comes, in double precision
    "half": {"refine": 2},  # float32: of runs that are judged by whether they stand
    "g2": {"dtype": "float64", "refine": 2},  # of a sheet on twice the mesh, whose stable step is half as long already
    "g1": {"dtype": "float64", "refine": 4},  # errors of other methods
    "fine": {"dtype": "float64", "refine": 16},  # errors of the explicit solver too
    "limit": {"dtype": "float64", "refine": 64},  # orders of convergence
}
