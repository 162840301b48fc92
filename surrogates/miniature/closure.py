"""What the coarse sheet weighs and resists: scalings of the material, and the fitted factors that are shipped."""

from collections.abc import Mapping
from functools import cache
from typing import Any

from cloth_envs.files import read_json
from cloth_envs.material import Material
from surrogates.checkpoint import WEIGHTS

SCALINGS = ("similar", "seed", "rule", "calibrated", "closure")
# Material properties that a rule for all scenes and a calibration multiply; a closure multiplies those after them too.
RULE = ("damping", "compression")
FACTORS = ("areal_density", "stretch_stiffness", "shear_stiffness", "bend_stiffness", "damping", "compression")
CLOSURE = (*FACTORS, "buckling_strain", "post_buckling", "compression_damping")


@cache
def card(scaling: str = "calibrated") -> dict[str, Any]:
    """All factors by scene and grid factor, with how they were fitted; ``scaling`` is also the file's name.

    Raises:
        ValueError: the file is damaged.
    """
    remedy = "restore it, or fit it anew with `python -m training.calibrate`"
    return read_json(WEIGHTS / f"{scaling}.json", "scenes", remedy=remedy)


def load_factors(scene: str, factor: float, scaling: str = "calibrated") -> dict[str, float]:
    """Material property -> multiplier for a scene at 1/``factor`` of its resolution; a rule's are those of any.

    Raises:
        ValueError: no calibration of this scene; says which there are.
    """
    scenes = card(scaling)["scenes"]
    if scaling == "rule":  # two numbers for all scenes
        scene, factor = next((name, int(key)) for name, fits in scenes.items() for key in fits)
    if scene not in scenes:
        raise ValueError(
            f"no {scaling} factors for scene {scene!r}, only for {', '.join(scenes)}: "
            f'use scaling="similar", or fit some with `python -m training.calibrate --scaling {scaling}`'
        )
    return scenes[scene][str(factor)]["factors"]


def miniature_material(material: Material, factor: float, scaling: str, factors: Mapping[str, float]) -> Material:
    """The material of the full-size coarse sheet that moves as the miniature does, in its own units.

    A miniature is the down-sampled cloth with its axes divided by ``s``: rest length, particle mass and step
    are the fine cloth's, external forces are divided by ``s``. Enlarged ``s`` times it is a coarse sheet of
    the same density. ``"seed"`` (Lee et al. 2019) keeps the spring constants: enlarged, the sheet is ``s^2``
    times too stiff in stretch and shear and ``s^4`` times in bending. ``"similar"`` divides them by that, which
    leaves the material itself. The others multiply its properties by fitted ``factors``.
    """
    if scaling == "seed":
        return material.with_changes(
            stretch_stiffness=material.stretch_stiffness * factor**2,
            shear_stiffness=material.shear_stiffness * factor**2,
            bend_stiffness=material.bend_stiffness * factor**4,
        )
    return material.with_changes(**{name: getattr(material, name) * value for name, value in factors.items()})
