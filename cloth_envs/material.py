"""Sheet materials in SI units, and a few named fabrics."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import cache
from typing import Any

import numpy as np
from gymnasium import logger

from cloth_envs.arguments import as_items, as_number
from cloth_envs.naming import unknown_name

LIGHT = 2e-4  # s, of damping; what kernels/sheet/sheet.hpp has too


@dataclass(frozen=True)
class Material:
    """A sheet, independent of the resolution of its grid.

    Attributes:
        areal_density: mass per area [kg/m^2].
        stretch_stiffness: force per width and strain of the threads [N/m]; the shear springs' diagonals
            add ``shear_stiffness`` (on square cells) to what a strip feels.
        shear_stiffness: force per width and shear angle [N/m].
        bend_stiffness: moment per width and curvature [N m].
        damping: Kelvin-Voigt relaxation time of stretch and shear [s]; an edge of stiffness ``k``
            has a dashpot ``damping * k``.
        drag: rate at which velocities decay [1/s], on top of what a scene's air does.
        compression: stiffness of the springs when they are shortened over that when they are lengthened, 0 to 1. A
            wrinkled sheet hardly resists compression (Pipkin 1986); a grid too coarse for its wrinkles needs less
            than 1 to move like it.
        buckling_strain: how much a spring shortens, over its rest length, before that stiffness falls further.
        post_buckling: what is left of it then, 0 to 1.
        compression_damping: damping of a shortened spring over that of a lengthened one: wrinkles have to be moved
            when they open or close.
        twist: stiffness against twist over that of an isotropic plate of this ``bend_stiffness``. At 1 bending costs
            the same along threads and on the bias; at 0 rows and columns bend on their own.

    Raises:
        ValueError: a value that is not finite, negative, (density, stretch) not positive or (compression,
            post_buckling) over 1.
    """

    areal_density: float = 0.2
    stretch_stiffness: float = 500.0
    shear_stiffness: float = 150.0
    bend_stiffness: float = 2e-5
    damping: float = 5e-5
    drag: float = 0.0
    compression: float = 1.0
    buckling_strain: float = 1.0
    post_buckling: float = 1.0
    compression_damping: float = 1.0
    twist: float = 1.0

    def __post_init__(self) -> None:
        for field in fields(self):
            given = getattr(self, field.name)
            value = as_number(given)
            if value is None:
                raise ValueError(f"material {field.name} must be a number, got {given!r}")
            positive = field.name in ("areal_density", "stretch_stiffness")
            if not np.isfinite(value) or value < 0 or (positive and value == 0):
                need = "positive" if positive else "zero or positive"
                raise ValueError(f"material {field.name} must be {need} and finite, got {given!r}")
            object.__setattr__(self, field.name, value)
        for name in ("compression", "post_buckling"):
            if getattr(self, name) > 1:
                raise ValueError(f"material {name} must be at most 1, got {getattr(self, name)!r}")

    @property
    def yields(self) -> bool:
        """Whether springs are another thing when they are shortened than when they are lengthened."""
        return (self.compression, self.post_buckling, self.compression_damping) != (1, 1, 1)

    @property
    def simple(self) -> bool:
        """Whether springs are linear and hardly damped: the explicit solver then has dashpots in their lengths.

        That differs from a dashpot by ``(damping w / d)^2`` and the strain, where edges of length d change at a rate w.
        """
        return not self.yields and self.damping <= LIGHT

    def with_changes(self, **changes: float) -> "Material":
        """A copy with some values replaced.

        Raises:
            ValueError: a property that does not exist, or a value out of range.
        """
        for name in changes:
            if name not in PROPERTIES:
                raise unknown_name("material property", name, PROPERTIES, meant=MEANT.get(name))
        return replace(self, **changes)

    def as_dict(self) -> dict[str, float]:
        return asdict(self)


PROPERTIES = tuple(field.name for field in fields(Material))

# What other packages and people call it.
MEANT = {
    "mass": "areal_density",
    "weight": "areal_density",
    "density": "areal_density",
    "stiffness": "stretch_stiffness",
    "spring": "stretch_stiffness",
    "elasticity": "stretch_stiffness",
    "young": "stretch_stiffness",
    "youngs_modulus": "stretch_stiffness",
    "bending": "bend_stiffness",
    "bending_stiffness": "bend_stiffness",
    "air_drag": "drag",
}

# What any cloth has, from gauze to leather, with room on either side: beyond it a value is in another unit. Threads
# reach 50 times the stretch stiffness of FABRICS; 0 switches a term off.
USUAL: dict[str, tuple[float, float, str]] = {
    "areal_density": (0.005, 5.0, "kg/m^2: 200 g/m^2 is written 0.2"),
    "stretch_stiffness": (1.0, 2e5, "N/m: Young's modulus [Pa] times the thickness [m]"),
    "shear_stiffness": (0.1, 2e4, "N/m: 1 gf/cm/degree is written 56"),
    "bend_stiffness": (1e-8, 0.01, "N m: 0.1 gf cm^2/cm is written 9.8e-6"),
    "damping": (0.0, 0.01, "s: a relaxation time, no damping ratio, such as 5e-5"),
    "drag": (0.0, 20.0, "1/s: the rate at which velocities decay, such as 0.5; scenes have their air besides"),
    "buckling_strain": (0.0, 1.0, "a share of the length: 3 % is written 0.03"),
    "compression_damping": (0.0, 8.0, "a ratio of two dampings, such as 4"),
    "twist": (0.0, 2.0, "over that of an isotropic plate: 1"),
}

# Density, shear and bending follow KES-F measurements of such cloths (Kawabata 1980: shear
# rigidity 0.3-3 gf/cm/deg, bending 0.003-0.4 gf cm^2/cm, 1 gf cm^2/cm = 9.8e-5 N m). Stretch is a
# working stiffness: real threads are 5-50 times stiffer, but at these values a hanging metre and a
# half already gains less than 1 % under its own weight, and the stable step stays long.
FABRICS: dict[str, Material] = {
    "default": Material(),
    "silk": Material(0.07, 300.0, 20.0, 3e-6, 5e-5),
    "cotton": Material(0.13, 500.0, 50.0, 8e-6, 5e-5),
    "wool": Material(0.25, 600.0, 60.0, 1.5e-5, 8e-5),
    "denim": Material(0.40, 1500.0, 250.0, 6e-5, 8e-5),
    "leather": Material(0.70, 3000.0, 900.0, 4e-4, 1e-4),
}


def warn_unusual(
    material: Material | str | Mapping[str, Any] | None, ranges: Mapping[str, tuple[float, float]]
) -> None:
    """Warn once, with the unit, of each value that no cloth has of those that ``material`` and ``ranges`` give."""
    own = material.as_dict() if isinstance(material, Material) else material if isinstance(material, Mapping) else {}
    for name, (low, high, unit) in USUAL.items():
        fixed = [own[name]] if name in own else []
        for what, values in ((f"material {name}", fixed), (f"randomize[{name!r}]", ranges.get(name, ()))):
            odd = next((value for value in values if value and not low <= value <= high), None)
            if odd is not None:
                warn_once(f"{what}={odd:g} is far from what cloths have ({low:g} to {high:g}); its unit is {unit}")


@cache
def warn_once(text: str) -> None:
    """Warn the first time in this process: many environments are made alike."""
    logger.warn("%s", text)


def as_material(value: Material | str | Mapping[str, Any] | None, default: Material) -> Material:
    """A ``Material`` from a fabric's name, changes to ``default``, a ``Material`` or nothing.

    Raises:
        ValueError: an unknown fabric or property (the nearest match is named), or a bad value.
    """
    if value is None:
        return default
    if isinstance(value, Material):
        return value
    if isinstance(value, str):
        if value not in FABRICS:
            raise unknown_name("fabric", value, FABRICS)
        return FABRICS[value]
    if isinstance(value, Mapping):
        changes = dict(value)
        fabric = changes.pop("fabric", None)
        base = default if fabric is None else as_material(fabric, default)
        return base.with_changes(**changes)
    raise ValueError(
        f'material must be a fabric\'s name or a dict of properties such as {{"areal_density": 0.3}}, got {value!r}'
    )


def check_ranges(randomize: Mapping[str, Sequence[float]] | None) -> dict[str, tuple[float, float]]:
    """What ``randomize`` says, ``{property: (low, high)}``.

    Raises:
        ValueError: an unknown property (the nearest match is named), or a range that is none.
    """
    if randomize is None:
        return {}
    if not isinstance(randomize, Mapping):
        raise ValueError(f'randomize must be a dict such as {{"drag": (0.2, 0.8)}}, got {randomize!r}')
    ranges = {}
    for name, limits in randomize.items():
        if name not in PROPERTIES:
            raise unknown_name("material property in randomize:", name, PROPERTIES, meant=MEANT.get(name))
        items = as_items(limits) or []
        low, high = map(as_number, items) if len(items) == 2 else (None, None)
        if low is None or high is None or not low <= high:
            raise ValueError(f"randomize[{name!r}] must be two numbers (low, high) with low <= high, got {limits!r}")
        for value in (low, high):
            try:
                Material().with_changes(**{name: value})
            except ValueError as error:
                raise ValueError(f"randomize[{name!r}]: {error}") from error
        ranges[name] = (low, high)
    return ranges
