"""Fitted material factors of the calibrated miniature, shipped as data."""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import files
from typing import Any

FILE = "calibrated.json"


@cache
def card() -> dict[str, Any]:
    """All factors by scene and grid factor, with how they were fitted."""
    return json.loads((files("surrogates") / "weights" / FILE).read_text())


def load_factors(scene: str, factor: int) -> dict[str, float]:
    """Material property -> multiplier for a scene at 1/``factor`` of its resolution.

    Raises:
        ValueError: no calibration of this scene; says which there are.
    """
    scenes = card()["scenes"]
    if scene not in scenes:
        raise ValueError(
            f"no calibration for scene {scene!r}, only for {', '.join(scenes)}: "
            'use scaling="similar", or fit one with `python -m training.calibrate`'
        )
    return scenes[scene][str(factor)]["factors"]
