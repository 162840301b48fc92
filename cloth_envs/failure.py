"""When a simulation has failed: the rules are the same for every backend, for the cloth that it integrates."""

from _minicloth_kernels import inspect

from cloth_envs.grid import Grid
from cloth_envs.scene import Scene
from cloth_envs.state import Health, State

MAX_STRAIN = 1.0  # an edge at twice its rest length
MAX_ENERGY_JUMP = 200.0  # J/kg gained in one frame, 20 m/s on every vertex


def find(grid: Grid, state: State) -> Health:
    """What ``State.health`` says of cloths on ``grid``."""
    return inspect(state.positions, state.velocities, grid.row_spacing, grid.col_spacing, grid.periodic)


class Failures:
    """Checks one frame: ``"non-finite"``, ``"overstretch"`` (an edge over ``max_strain``) or ``"energy"`` (a jump).

    Of a state with ``health`` that decides, which a backend fills in that integrates another cloth than it shows.
    """

    def __init__(self, scene: Scene, max_strain: float = MAX_STRAIN) -> None:
        self.grid, self.max_strain = scene.grid, max_strain
        self.health: Health = []  # of the frame checked last

    def check(self, before: State, after: State) -> dict[int, str]:
        """The reason of each member of the batch that has failed."""
        now = self.health = after.health or find(self.grid, after)
        for finite, strain, kinetic in now:
            if not (finite and strain <= self.max_strain and kinetic <= MAX_ENERGY_JUMP):
                break
        else:
            return {}
        then = before.health or find(self.grid, before)
        found = (self.reason(a[0], a[1], a[2] - b[2]) for a, b in zip(now, then, strict=True))
        return {i: reason for i, reason in enumerate(found) if reason}

    def reason(self, finite: bool, strain: float, gained: float) -> str | None:
        """Why a cloth has failed of this strain that gained so much energy [J/kg] in a frame, or None."""
        if not finite:
            return "non-finite"
        if strain > self.max_strain:
            return "overstretch"
        return "energy" if gained > MAX_ENERGY_JUMP else None
