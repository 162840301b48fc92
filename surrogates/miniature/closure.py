"""Fitted material factors of the calibrated miniature and of the closure, shipped as data."""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import files
from typing import Any


@cache
def card(scaling: str = "calibrated") -> dict[str, Any]:
    """All factors by scene and grid factor, with how they were fitted; ``scaling`` is also the file's name."""
    return json.loads((files("surrogates") / "weights" / f"{scaling}.json").read_text())


def load_factors(scene: str, factor: int, scaling: str = "calibrated") -> dict[str, float]:
    """Material property -> multiplier for a scene at 1/``factor`` of its resolution.

    Raises:
        ValueError: no calibration of this scene; says which there are.
    """
    scenes = card(scaling)["scenes"]
    if scene not in scenes:
        raise ValueError(
            f"no {scaling} factors for scene {scene!r}, only for {', '.join(scenes)}: "
            f'use scaling="similar", or fit some with `python -m training.calibrate --scaling {scaling}`'
        )
    return scenes[scene][str(factor)]["factors"]
