"""The fitted cell of a sheet on a graphics card: what it was identified to be, one block of threads a cloth."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from cloth_envs.material import Material
from cloth_envs.physics.gpu.solver import CardSolver
from cloth_envs.scene import Scene
from surrogates.cell.compiled import felt_as


class CellCard(CardSolver):
    """``CellSheet`` on a card; ``factors`` and ``options`` are those of ``CellSheet`` and ``CardSolver``."""

    def __init__(self, scene: Scene, factors: Mapping[str, float], **options: Any) -> None:
        self._factors = dict(factors)
        gravity = scene.gravity * self._factors.pop("gravity")
        super().__init__(replace(scene, gravity=gravity), **options)
        self.scene = scene

    def felt_as(self, material: Material) -> Material:
        return felt_as(material, self._factors)
