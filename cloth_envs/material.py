"""Sheet materials in SI units, and a few named fabrics."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np

from cloth_envs.naming import unknown_name


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
        drag: rate at which still air slows the cloth [1/s].
        compression: stiffness of the springs when they are shortened over that when they are lengthened, 0 to 1. A
            wrinkled sheet hardly resists compression (Pipkin 1986); a grid too coarse for its wrinkles needs less
            than 1 to move like it.
        buckling_strain: how much a spring shortens, over its rest length, before that stiffness falls further.
        post_buckling: what is left of it then, 0 to 1.
        compression_damping: damping of a shortened spring over that of a lengthened one: wrinkles have to be moved
            when they open or close.

    Raises:
        ValueError: a value that is not finite, negative, (density, stretch) not positive or (compression,
            post_buckling) over 1.
    """

    areal_density: float = 0.2
    stretch_stiffness: float = 500.0
    shear_stiffness: float = 150.0
    bend_stiffness: float = 2e-5
    damping: float = 5e-5
    drag: float = 0.5
    compression: float = 1.0
    buckling_strain: float = 1.0
    post_buckling: float = 1.0
    compression_damping: float = 1.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, bool) or not isinstance(value, (int, float, np.floating, np.integer)):
                raise ValueError(f"material {field.name} must be a number, got {value!r}")
            positive = field.name in ("areal_density", "stretch_stiffness")
            if not np.isfinite(value) or value < 0 or (positive and value == 0):
                need = "positive" if positive else "zero or positive"
                raise ValueError(f"material {field.name} must be {need} and finite, got {value!r}")
            object.__setattr__(self, field.name, float(value))
        for name in ("compression", "post_buckling"):
            if getattr(self, name) > 1:
                raise ValueError(f"material {name} must be at most 1, got {getattr(self, name)!r}")

    @property
    def yields(self) -> bool:
        """Whether springs are another thing when they are shortened than when they are lengthened."""
        return (self.compression, self.post_buckling, self.compression_damping) != (1, 1, 1)

    def with_changes(self, **changes: float) -> "Material":
        """A copy with some values replaced.

        Raises:
            ValueError: a property that does not exist, or a value out of range.
        """
        for name in changes:
            if name not in PROPERTIES:
                raise unknown_name("material property", name, PROPERTIES)
        return replace(self, **changes)

    def as_dict(self) -> dict[str, float]:
        return asdict(self)


PROPERTIES = tuple(field.name for field in fields(Material))

# Density, shear and bending follow KES-F measurements of such cloths (Kawabata 1980: shear
# rigidity 0.3-3 gf/cm/deg, bending 0.003-0.4 gf cm^2/cm, 1 gf cm^2/cm = 9.8e-5 N m). Stretch is a
# working stiffness: real threads are 5-50 times stiffer, but at these values a hanging metre and a
# half already gains less than 1 % under its own weight, and the stable step stays long.
FABRICS: dict[str, Material] = {
    "default": Material(),
    "silk": Material(0.07, 300.0, 20.0, 3e-6, 5e-5, 1.2),
    "cotton": Material(0.13, 500.0, 50.0, 8e-6, 5e-5, 0.8),
    "wool": Material(0.25, 600.0, 60.0, 1.5e-5, 8e-5, 0.5),
    "denim": Material(0.40, 1500.0, 250.0, 6e-5, 8e-5, 0.3),
    "leather": Material(0.70, 3000.0, 900.0, 4e-4, 1e-4, 0.2),
}


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
    raise ValueError(f"material must be a fabric's name or a dict of properties, got {value!r}")


def check_ranges(randomize: Mapping[str, Sequence[float]] | None) -> dict[str, tuple[float, float]]:
    """What ``randomize`` says, ``{property: (low, high)}``.

    Raises:
        ValueError: an unknown property (the nearest match is named), or a range that is none.
    """
    ranges = {}
    for name, limits in (randomize or {}).items():
        if name not in PROPERTIES:
            raise unknown_name("material property in randomize", name, PROPERTIES)
        if not isinstance(limits, Sequence) or len(limits) != 2 or not limits[0] <= limits[1]:
            raise ValueError(f"randomize[{name!r}] must be (low, high) with low <= high, got {limits!r}")
        for value in limits:
            Material().with_changes(**{name: value})
        ranges[name] = (float(limits[0]), float(limits[1]))
    return ranges
