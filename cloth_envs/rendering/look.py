"""Colours, textures and lights: the look of every picture."""

from typing import Any

import numpy as np

from cloth_envs.style import INK

SKY, FLOOR = "#bccbd9", "#eceff1"
CLOTH_FRONT, CLOTH_BACK = "#e0553c", "#f3d3b3"
WOOD, BRASS, STEEL, BODY, ARROW = "#a67c5b", "#d0a548", "#6d7883", "#5d7f9f", "#2b7a9b"
GOAL, MET, GHOST = "#7a3db8", "#16a05a", 0.38  # marks of a goal, once it is met, and how much of a ghost is seen
CLOTH = {"ambient": 0.30, "diffuse": 0.92, "specular": 0.08, "specular_power": 8}  # a wide, weak sheen
SOLID = {"ambient": 0.34, "diffuse": 0.85, "specular": 0.25, "specular_power": 25}
# Moreland's diverging map: perceptually even, safe for colour blindness.
STRAIN = {"scalars": "strain", "cmap": "coolwarm", "show_scalar_bar": False, "ambient": 0.42, "diffuse": 0.72}
# The bar of strain, small, in the lower right corner.
BAR = {"vertical": True, "n_labels": 3, "fmt": "%.3g", "color": INK, "height": 0.34, "position_y": 0.12}
BAR |= {"unconstrained_font_size": True, "title_font_size": 12, "label_font_size": 12}
WEAVE_SIZE = 0.24  # m of cloth in one repeat of the weave
SHADOW_TILT = 0.55  # m sideways for a metre down

# Direction towards each light (right, towards the camera, up), colour and strength.
LIGHTS = (
    ((-0.60, 0.90, 0.75), "#fff3e4", 0.86),  # warm key, from the left
    ((0.95, 0.50, 0.20), "#dde9ff", 0.26),  # cool fill, from the right
    ((0.30, -0.90, 0.50), "#ffffff", 0.30),  # rim, from behind
)


def level_axes(view: np.ndarray) -> np.ndarray:
    """Right, towards the camera and up as rows ``(3, 3)``, both level, for a camera direction ``view``."""
    level = np.array([view[0], view[1], 0.0])
    size = np.linalg.norm(level)
    towards = level / size if size > 1e-9 else np.array([0.0, -1.0, 0.0])
    return np.stack([np.cross([0.0, 0.0, 1.0], towards), towards, [0.0, 0.0, 1.0]])


def smooth_edges(renderer: Any) -> None:
    """FXAA, the cheapest antialiasing on a CPU (MSAA and supersampling cost 2-3 times as much).

    Its thresholds pass over the faint lines of weave and floor. PyVista's own switch refuses FXAA with
    EGL, where it works.
    """
    renderer.SetUseFXAA(True)
    options = renderer.GetFXAAOptions()
    options.SetRelativeContrastThreshold(0.2)
    options.SetHardContrastThreshold(0.1)
    options.SetUseHighQualityEndpoints(False)


def weave(cells: int = 96) -> np.ndarray:
    """One repeat of a woven check, ``(cells, cells, 3)`` uint8, that multiplies the cloth's colour.

    Bands of darker warp and weft threads cross; a fine twill runs over them.
    """
    at = np.arange(cells)
    phase, edge = at / cells, 0.04
    band = np.clip((0.25 + edge - np.abs(phase - 0.5)) / (2 * edge), 0, 1)
    line = np.exp(-(((phase - 0.06) / 0.016) ** 2))
    threads = 0.12 * band + 0.09 * line
    twill = 0.018 * np.where((at[:, None] + at) % 4 < 2, 1, -1)
    tone = 0.98 - threads[:, None] - threads + twill
    return (255 * np.clip(tone, 0, 1)).astype(np.uint8)[..., None].repeat(3, -1)
