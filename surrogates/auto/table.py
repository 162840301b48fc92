"""Time and error of every backend in a scene, as ``minicloth bench choices`` measured them, and a choice by them.

Errors are those of the candidate's own run, under four kinds of open-loop actions, against the reference that goes on
from its cloth.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from cloth_envs.files import read_json
from cloth_envs.material import Material
from cloth_envs.scene import Scene
from surrogates.checkpoint import WEIGHTS
from surrogates.miniature.card import Card, numbers

HORIZONS = (1, 5, 10, 25)  # frames at which errors are known
MARGIN = 1.25  # by which an error stays under the tolerance: other actions have other errors
ALIKE = (0.8, 1.25)  # a material's numbers over those of the table's cloth


@dataclass(frozen=True)
class Option:
    """A backend of the table: its name, options and time of a frame [ms], and its error at each horizon.

    Errors are what 95 % of the windows stay under, of the worst kind of action [% of the cloth's length].
    """

    backend: str
    options: Mapping[str, Any]
    ms: float
    errors: Mapping[int, float]

    def __str__(self) -> str:
        return " ".join([self.backend, *(f"{name}={value}" for name, value in self.options.items())])


REFERENCE = Option("reference", {"solver": "explicit"}, float("nan"), dict.fromkeys(HORIZONS, 0.0))


@dataclass(frozen=True)
class Table:
    """What was measured of a scene: ``options``, the cheapest first, and the chaos ``floor`` at each horizon [%]."""

    card: Card
    options: tuple[Option, ...]
    floor: Mapping[int, float]

    @classmethod
    @cache
    def of(cls, scene: str) -> "Table | None":
        """That of a scene's name; None if there is none.

        Raises:
            ValueError: the file is damaged.
        """
        remedy = "restore it, or measure it anew with `minicloth bench choices`"
        found = read_json(WEIGHTS / "auto.json", "scenes", remedy=remedy)["scenes"].get(scene)
        if found is None:
            return None
        read = [Option(o["backend"], o["options"], o["ms"], _by_frame(o["error"])) for o in found["backends"]]
        card = Card.read(scene, found["measured on"])
        return cls(card, tuple(sorted(read, key=lambda option: option.ms)), _by_frame(found["floor"]))

    def beyond(self, scene: Scene, material: Material) -> str:
        """Why ``scene`` with cloth of ``material`` is not what was measured; empty if it is."""
        measured = self.card.scene
        if scene.grid != measured.grid:
            return f"{scene.grid} vertices, measured on {measured.grid}"
        if other := self.card.scene_beyond(scene) or self.card.material_beyond(material):
            return other
        base, found = numbers(measured, measured.material), numbers(scene, material)
        for name, value in found.items():
            if base[name] and not ALIKE[0] <= value / base[name] <= ALIKE[1]:
                return f"{name} {value / base[name]:.3g} times that of the cloth that was measured"
        return ""

    def ladder(self, tolerance: float, horizon: int) -> tuple[list[Option], str]:
        """The cheapest option that holds ``tolerance`` [%] at ``horizon``, those closer, the reference; and why.

        Raises:
            ValueError: a tolerance below the chaos floor, which is told.
        """
        floor = self.floor[horizon]
        if tolerance < floor:
            raise ValueError(
                f"tolerance={tolerance:g} is below the chaos floor: two references a millionth of the cloth's length "
                f"apart differ by {floor:.4g} % after {horizon} frames: take at least that, or a nearer horizon"
            )
        held = [option for option in self.options if option.errors[horizon] * MARGIN <= tolerance]
        return self._from(held[0], horizon) if held else ([REFERENCE], "no surrogate holds the tolerance")

    def within(self, budget_ms: float, horizon: int) -> tuple[list[Option], str]:
        """The same for the closest option whose frame takes at most ``budget_ms``.

        Raises:
            ValueError: none is so cheap; the cheapest is told.
        """
        cheap = [option for option in self.options if option.ms <= budget_ms]
        if not cheap:
            least = self.options[0]
            raise ValueError(f"budget_ms={budget_ms:g} is below the cheapest, {least} with {least.ms:.4g} ms a frame")
        return self._from(min(cheap, key=lambda option: option.errors[horizon]), horizon)

    def _from(self, first: Option, horizon: int) -> tuple[list[Option], str]:
        closer = [option for option in self.options if option.errors[horizon] < first.errors[horizon]]
        steps = [first]
        for option in closer:  # dearer and dearer ones, each closer than the one before
            if option.ms > steps[-1].ms and option.errors[horizon] < steps[-1].errors[horizon]:
                steps.append(option)
        steps = [option for option in steps if option.backend != "reference"]
        error, ms = first.errors[horizon], first.ms
        why = f"error up to {error:.2g} % after {horizon} frames in 95 % of the windows, {ms:.2g} ms a frame"
        return [*steps, REFERENCE], why


def _by_frame(errors: Mapping[str, float]) -> dict[int, float]:
    return {int(frame): error for frame, error in errors.items()}


def choose(scene: Scene, tolerance: float | None, budget_ms: float | None, horizon: int) -> tuple[list[Option], str]:
    """Which backends ``scene`` gets, the first to begin with, and why.

    Raises:
        ValueError: see ``Table``.
    """
    table = Table.of(scene.name)
    why = f"no table of {scene.name}" if table is None else table.beyond(scene, scene.material)
    if table is None or why:
        return [REFERENCE], why
    if budget_ms is not None:
        return table.within(budget_ms, horizon)
    return table.ladder(np.inf if tolerance is None else tolerance, horizon)
