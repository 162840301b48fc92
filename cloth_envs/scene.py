"""What exists in a scene and which forces are modelled; no solver word in it."""

from collections import Counter
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from cloth_envs.grid import Grid
from cloth_envs.grip import Grip, Holding
from cloth_envs.material import Material
from cloth_envs.naming import unknown_name
from cloth_envs.particles import Particles

GRAVITY = 9.81  # m/s^2
KINDS = ("sphere", "capsule", "plane")  # of bodies
LAYERS = 4  # of a folded cloth, at least, in the height of one cell


@dataclass(frozen=True)
class Air:
    """The air around the cloth, still or blowing, on cells that move through it with ``u`` at an angle ``a``.

    The pressure along the normal is ``rho/2 |u|^2 (normal sin^2 a + lift sin a cos a)``, the drag of a plate across the
    flow and its lift (Polhamus 1966, as Wejchert & Haumann 1991 without the lift); the friction along the surface
    ``rho/2 |u|^2 tangential cos^2 a``. The air's own flow and mass are not modelled.

    Attributes:
        density: of the air [kg/m^3].
        normal, lift, tangential: the coefficients.
        max_wind: the fastest wind that the scene can blow [m/s], 0 where the air is still.
    """

    density: float = 1.2
    normal: float = 1.5
    lift: float = 1.0
    tangential: float = 0.02
    max_wind: float = 0.0

    def __str__(self) -> str:
        coefficients = f"normal {self.normal:g}, lift {self.lift:g}, tangential {self.tangential:g}"
        return f"density {self.density:g} kg/m^3, {coefficients}"


@dataclass(frozen=True)
class SelfContact:
    """The contact of the cloth with itself: two of its layers can't pass through each other.

    Attributes:
        thickness: distance [m] at which layers lie on each other; less on a fine grid, see ``Scene.layer``.
        friction: the coefficient mu between layers (Coulomb).
    """

    thickness: float = 0.004
    friction: float = 0.3


@dataclass(frozen=True)
class Collider:
    """A body that the cloth can't enter, with Coulomb friction.

    ``kind`` is ``"sphere"``, ``"capsule"`` or ``"plane"``; where it is belongs to the state: the two
    end points of a capsule's axis, twice the centre of a sphere, a point and the unit normal of a
    plane. ``radius`` [m] (0 for a plane); ``friction`` is the coefficient mu. ``turns_with`` is the number of another
    capsule of the scene, with whose axis this one turns about its own as a hip does with the line between the thighs;
    None for one that doesn't spin.

    Raises:
        ValueError: another kind; of the scene: ``turns_with`` of what is no capsule, or that names none of the others.
    """

    kind: str
    radius: float = 0.0
    friction: float = 0.3
    name: str = "body"
    turns_with: int | None = None

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise unknown_name("kind of body", self.kind, KINDS)

    @property
    def spin(self) -> str:
        """Whether it spins, as text."""
        return "" if self.turns_with is None else ", spinning about its axis"


@dataclass(frozen=True)
class Scene:
    """A frozen description in SI units. Backends build exactly the terms listed here.

    Attributes:
        name: the scene's name, as in ``MiniCloth-<name>-v0``.
        grid, material: the cloth.
        frame_dt: length of one environment step [s].
        handles: vertex numbers that are driven (or pinned, when the controls do not move them).
        grips: which of the handles are patches of cloth that are held, firmly in their middle and softly around it;
            other handles are firm.
        air: what moving through the air does to triangles, or None.
        pressure: a pressure difference [Pa] acts on triangles.
        colliders: bodies, in the order of ``State.colliders``.
        thickness: distance [m] that contact keeps between a body and the cloth's vertices.
        self_contact: how the cloth keeps out of itself, or None where its folds can pass through each other.
        particles: the cloth is this net of particles instead of a sheet; ``material`` is then only its nearest
            sheet, ``pressure`` the ``p`` of ``p sum r_a x r_b`` [Pa] over four pairs of neighbours, and contact
            has no thickness.
        driven_by: the task that starts and drives it, ``module:Class``, where that is none of this package.
    """

    name: str
    grid: Grid
    material: Material
    frame_dt: float
    handles: tuple[int, ...] = ()
    grips: tuple[Grip, ...] = ()
    air: Air | None = None
    pressure: bool = False
    colliders: tuple[Collider, ...] = ()
    thickness: float = 0.005
    gravity: float = GRAVITY
    particles: Particles | None = None
    self_contact: SelfContact | None = None
    driven_by: str = ""

    def __post_init__(self) -> None:
        capsules = [i for i, body in enumerate(self.colliders) if body.kind == "capsule"]
        for number, body in enumerate(self.colliders):
            others = [i for i in capsules if i != number]
            if body.turns_with is not None and (number not in capsules or body.turns_with not in others):
                raise ValueError(
                    f"{body.kind} {body.name!r} of {self.name} can't turn with {body.turns_with!r}: only capsules turn "
                    f"about their axes, with one of the others ({', '.join(map(str, others)) or 'there is none'})"
                )

    def with_material(self, material: Material) -> "Scene":
        return replace(self, material=material)

    def with_self_contact(self, wanted: bool | None) -> "Scene":
        """With contact of the cloth with itself, as listed or the usual one, or without; None: as listed.

        Raises:
            ValueError: a net of particles, which has none.
        """
        if wanted is None or wanted is (self.self_contact is not None):
            return self
        if wanted and self.particles is not None:
            raise ValueError(
                f"self_contact=True: this preset of {self.name} is a net of particles, which has none: "
                "leave self_contact or preset out"
            )
        return replace(self, self_contact=SelfContact() if wanted else None)

    @property
    def layer(self) -> float:
        """Distance [m] at which layers of the cloth lie on each other; 0 where nothing keeps them apart."""
        if self.self_contact is None:
            return 0.0
        return min(self.self_contact.thickness, min(self.grid.row_spacing, self.grid.col_spacing) / LAYERS)

    @cached_property
    def holding(self) -> Holding:
        """How firmly each of the handles is held, and which one it follows."""
        return Holding.of(self.grid, self.handles, self.grips)

    @cached_property
    def pins(self) -> tuple[int, ...]:
        """The handles that are firm: of every grip the vertex that leads it, and all that are in none."""
        return tuple(v for v, firm in zip(self.handles, self.holding.firm.tolist(), strict=True) if firm)

    def grip_stiffness(self, material: Material) -> np.ndarray:
        """Of the springs that draw handles to their places along x, y, z, ``(N, 3)`` [N/m]; infinite for firm ones."""
        area = self.grid.areas.ravel()[list(self.handles)]
        return self.holding.hold * material.stretch_stiffness * area[:, None]

    @property
    def windy(self) -> bool:
        """Whether the air can blow."""
        return self.air is not None and self.air.max_wind > 0

    @property
    def mass(self) -> np.ndarray:
        """Lumped vertex masses, ``(rows, cols)`` [kg]."""
        if self.particles is not None:
            return np.full(self.grid.shape, self.particles.node_mass)
        return self.grid.areas * self.material.areal_density

    def __repr__(self) -> str:
        g = self.grid
        return f"<Scene {self.name}, {g.height:g} x {g.width:g} m, {g}, frame {self.frame_dt * 1e3:g} ms>"

    def _held(self) -> str:
        """What holds the cloth, as text."""
        radii = Counter(grip.radius for grip in self.grips)
        grips = [f"{n} {'grips' if n > 1 else 'grip'} of {100 * r:g} cm around" for r, n in radii.items()]
        others = len(self.pins) - len(self.grips)
        return ", ".join([*grips, f"{others} handles"] if others or not grips else grips)

    def describe(self) -> str:
        """What is modelled and what is not, as text."""
        m, g, net = self.material, self.grid, self.particles
        twist = "twist of an isotropic plate" + ("" if m.twist in (0, 1) else f" times {m.twist:g}")
        contact = "friction {0.friction:g}" if net is None else f"velocity inside times {net.keep:g} a step"
        own = self.self_contact
        layers = "" if own is None else f", layers {1e3 * self.layer:.2g} mm apart, friction {own.friction:g}"
        terms = {
            "gravity": self.gravity > 0,
            "stretch and shear springs": True,
            **({} if net is None else {"springs at distance two against bending": True}),
            "damping along the springs": m.damping > 0,
            "springs that yield under compression": m.yields,
            "quadratic bending": m.bend_stiffness > 0,
            twist: m.bend_stiffness > 0 and m.twist > 0,
            "drag in proportion to the velocity": m.drag > 0,
            "air on cells" + (f" ({self.air})" if self.air else ""): self.air is not None,
            "wind": self.windy,
            "pressure" if net is None else "pressure p, four corners a vertex": self.pressure,
            **{f"contact with a {c.kind} ({c.name}), {contact.format(c)}{c.spin}": True for c in self.colliders},
            "contact with bodies": bool(self.colliders),
            f"self-contact{layers}": self.self_contact is not None,
            "plasticity, tearing, the air's own flow and mass": False,
        }
        if self.colliders:
            del terms["contact with bodies"]
            terms["forces of the cloth on bodies (they move as they are told)"] = False
        tube = ", closed across columns" if g.periodic else ""
        lines = [
            f"{self.name}: {g.height:g} x {g.width:g} m, {g.rows} x {g.cols} vertices{tube}, "
            f"{self._held()}, frame {self.frame_dt * 1e3:g} ms",
            f"material: {m.areal_density:g} kg/m^2, stretch {m.stretch_stiffness:g} N/m, "
            f"shear {m.shear_stiffness:g} N/m, bend {m.bend_stiffness:g} N m"
            if net is None
            else net.describe(),
            "modelled: " + "; ".join(name for name, on in terms.items() if on),
            "not modelled: " + "; ".join(name for name, on in terms.items() if not on),
        ]
        return "\n".join(lines)
