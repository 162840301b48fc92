"""Where a closure holds: the scene and cloth that it was fitted on, and how far from them it was measured to be good.

Cloths are compared by numbers without a unit (``numbers``), so that a larger sheet of a stiffer material may count as
the same. ``RANGES``, ``FEWEST``, ``FINEST`` and ``OBLONG`` are how far these and the grids may lie from those of the
fit: within them closure and network are nearer to the reference than the ``"similar"`` cloth (``minicloth bench
outside``).
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cache, cached_property
from typing import Any

import numpy as np

from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.registry import load_task
from cloth_envs.scene import Air, Scene

# number -> least and most of it over the fitted cloth's; of drag, which that has none of, the number itself.
RANGES: dict[str, tuple[float, float]] = {
    "stretch by its own weight": (0.2, 5.0),
    "shear stiffness over stretch stiffness": (0.2, 5.0),
    "bend stiffness over weight": (0.0, 6.0),
    "damping time over that of a wave": (0.0, 5.0),
    "drag over the time of a fall": (0.0, 1.0),
    "weight of the cloth over the air's": (0.2, 5.0),
}
TOGETHER = 1.51  # root of the sum of squares of how far all of them are, each over how far its range goes (logarithms)
TAUT = (0.9, 1.1)  # the same of every number of a cloth whose whole border is held: little is gained there, nor far
FEWEST = 0.49  # cells along a side over those of the task's own grid
FINEST = 0.6  # the same of the coarse grid: a finer one needs no closure
OBLONG = 1.5  # how many times longer than wide cells may be
LAW = ("compression", "buckling_strain", "post_buckling", "compression_damping", "twist")


def numbers(scene: Scene, material: Material) -> dict[str, float]:
    """What decides how a cloth of ``material`` moves in ``scene``, by the names of ``RANGES``."""
    height, weight = scene.grid.height, material.areal_density * scene.gravity
    air = height * (scene.air or Air()).density
    wave = height * np.sqrt(material.areal_density / material.stretch_stiffness)
    return {
        "stretch by its own weight": weight * height / material.stretch_stiffness,
        "shear stiffness over stretch stiffness": material.shear_stiffness / material.stretch_stiffness,
        "bend stiffness over weight": material.bend_stiffness / (weight * height**3),
        "damping time over that of a wave": material.damping / wave,
        "drag over the time of a fall": material.drag * np.sqrt(height / scene.gravity),
        "weight of the cloth over the air's": material.areal_density / air,
    }


@dataclass(frozen=True)
class Card:
    """What a scene's closure was fitted on: ``scene``, of its task's own grid and material."""

    scene: Scene

    @cached_property
    def taut(self) -> bool:
        """Whether the whole border is held."""
        return set(self.scene.grid.border.tolist()) <= set(self.scene.handles)

    @classmethod
    @cache
    def of(cls, name: str, resolution: tuple[int, int], material: tuple[float, ...]) -> "Card":
        """From what is stored: the scene's name, the grid's vertices and the properties of the material."""
        return cls(load_task(name).make_scene(resolution=resolution, material=Material(*material)))

    @classmethod
    @cache
    def own(cls, name: str) -> "Card":
        """Of a scene as it is by default: what tells few or oblong cells of one without a fit."""
        task = load_task(name)
        return cls(task.make_scene(resolution=task.resolution, material=task.material))

    @classmethod
    def read(cls, name: str, entry: Mapping[str, Any]) -> "Card":
        """From what the file says of a scene at a grid factor, ``"fitted on"``."""
        return cls.of(name, tuple(entry["resolution"]), tuple(Material(**entry["material"]).as_dict().values()))

    def beyond(self, scene: Scene, coarse: Grid) -> str:
        """Why the closure does not hold in ``scene`` on the ``coarse`` grid; empty if it does."""
        return self.scene_beyond(scene) or self.material_beyond(scene.material) or self.finer(coarse)

    def scene_beyond(self, scene: Scene) -> str:
        """Why the closure was not fitted on ``scene``, whatever its material; empty if it was.

        Other wind and other ways of handles and bodies are those of another task.
        """
        if scene.driven_by:
            return f"driven by {scene.driven_by}, another task than that of its fit"
        alike = replace(load_task(scene.name).make_scene(resolution=scene.grid.shape, material=scene.material),
                        self_contact=scene.self_contact)  # fmt: skip
        other = [field.name for field in fields(Scene) if getattr(scene, field.name) != getattr(alike, field.name)]
        if other:
            return f"another scene than the one of its fit: {', '.join(other)}"
        return ""

    def finer(self, coarse: Grid) -> str:
        """Why the ``coarse`` grid is finer than any of a fit; empty if it is not."""
        for what, mine, own in zip(("down", "across"), coarse.cells, self.scene.grid.cells, strict=True):
            if mine > FINEST * own:
                return f"{mine} coarse cells {what}, fitted up to {FINEST * own:.0f}"
        return ""

    def grid_beyond(self, fine: Grid, coarse: Grid) -> str:
        """Why the network was not trained for these grids, of few or oblong cells; empty if it was."""
        for what, mine, own in zip(("down", "across"), fine.cells, self.scene.grid.cells, strict=True):
            if mine < FEWEST * own:
                return f"{mine} cells {what}, fitted on {own}"
        for grid in (fine, coarse):
            oblong = max(grid.row_spacing / grid.col_spacing, grid.col_spacing / grid.row_spacing)
            if oblong > OBLONG:
                return f"cells {oblong:.2g} times longer than wide, fitted up to {OBLONG:g}"
        return ""

    def material_beyond(self, material: Material) -> str:
        """Why the closure does not hold for a cloth of ``material``; empty if it does."""
        fitted = self.scene.material
        for name in LAW:
            if getattr(material, name) != getattr(fitted, name):
                return f"{name} {getattr(material, name):g}, fitted on {getattr(fitted, name):g}"
        base, far = numbers(self.scene, fitted), 0.0
        for name, value in numbers(self.scene, material).items():
            ratio = value / base[name] if base[name] else value
            low, high = TAUT if self.taut and base[name] else RANGES[name]
            if not low <= ratio <= high:
                return f"{name} {ratio:.3g} times that of the fit, measured from {low:g} to {high:g}"
            if base[name] and (ratio > 1 or low):
                far += (np.log(ratio) / np.log(high if ratio > 1 else low)) ** 2
        if far**0.5 > TOGETHER and not self.taut:
            return f"a material {far**0.5 / TOGETHER:.3g} times as far from that of the fit as was measured, all in all"
        return ""
