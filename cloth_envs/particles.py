"""A cloth as a net of equal particles, for settings that no sheet in SI units has."""

from dataclasses import dataclass, fields

import numpy as np

from cloth_envs.material import Material


@dataclass(frozen=True)
class Particles:
    """Equal particles, each with springs to its 8 neighbours and to the 4 at distance two (Zhao 2024, eqs 1-5).

    Every particle weighs the same, on the border too, and every spring has the same constants, so what the
    net does depends on its resolution: it is no model of a sheet as ``Material`` is.

    Raises:
        ValueError: a value that is not finite, negative, or (mass, stiffness, step, spacing) not positive.
    """

    node_mass: float = 1.0  # of a particle [kg]
    stiffness: float = 1e4  # Y [N]; a spring of rest length L pulls with ``Y (|r| / L - 1)``
    dashpot: float = 3e4 / 128  # of a spring, along it [N s/m]
    drag: float = 3.0  # rate at which still air slows a particle [1/s]
    # What a step inside a ball leaves of the velocity relative to the ball; an inward one is removed before. It stands
    # for both friction and restitution.
    keep: float = 0.95
    sim_dt: float = 3.125e-4  # the step that the settings belong to [s]
    spacing: float = 1 / 128  # of the square grid that the settings belong to [m]

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            positive = field.name in ("node_mass", "stiffness", "sim_dt", "spacing")
            if not np.isfinite(value) or value < 0 or (positive and value == 0):
                need = "positive" if positive else "zero or positive"
                raise ValueError(f"particles' {field.name} must be {need} and finite, got {value!r}")

    def sheet(self) -> Material:
        """The nearest ``Material`` [SI]: what the net does inside, for small strains.

        Along every line of springs, one per spacing of width, there is one spring to the nearest neighbour and there
        are two side by side to those at distance two; each holds the force ``Y e`` at the strain ``e``. A diagonal's
        constant is ``Y / (sqrt(2) spacing)``. Springs at distance two bend with the fourth power of the angle: no
        bend stiffness.
        """
        return Material(
            areal_density=self.node_mass / self.spacing**2,
            stretch_stiffness=3 * self.stiffness / self.spacing,
            shear_stiffness=self.stiffness / (2**0.5 * self.spacing),
            bend_stiffness=0.0,
            damping=self.dashpot * self.spacing / self.stiffness,
            drag=self.drag,
        )

    def describe(self) -> str:
        """The settings as text."""
        return (
            f"particles: {self.node_mass:g} kg each, springs Y (|r|/L - 1) with Y = {self.stiffness:g} N "
            f"(Y/L = {self.stiffness / self.spacing:g} N/m to the nearest), dashpots {self.dashpot:g} N s/m, "
            f"drag {self.drag:g} 1/s, step {self.sim_dt * 1e3:g} ms, velocities changed in place, row by row"
        )
