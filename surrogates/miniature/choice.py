"""What a miniature is made of by default: closure and network where their card holds, else what is plainer."""

from typing import NamedTuple

from cloth_envs.registry import SCENES
from cloth_envs.scene import Scene
from surrogates.checkpoint import of_factor
from surrogates.miniature.card import Card
from surrogates.miniature.closure import card
from surrogates.miniature.coarse import coarse_grid
from surrogates.upscale.local import weights_name

LEAST = 6  # coarse cells along a side


class Choice(NamedTuple):
    """``scaling`` and ``upscaler`` by name, of how many cells along a side ``least`` are kept, and ``why`` if plain."""

    scaling: str = "similar"
    upscaler: str = "bicubic"
    least: int = 2
    why: str = ""


def closure_card(scene: str, factor: int) -> Card | None:
    """What the closure of a scene was fitted on; None if there is none."""
    entry = card("closure")["scenes"].get(scene, {}).get(str(factor)) if scene in SCENES else None
    return None if entry is None else Card.read(scene, entry["fitted on"])


def choose(scene: Scene, factor: int) -> Choice:
    """``"closure"`` and ``"local"`` within their card, else what is plainer.

    On another scene or cloth, on one that has no fit, or where the coarse grid is fine, that is ``"similar"`` and
    ``"bicubic"``. On grids of few or oblong cells a cloth that is not taut would tear with the network: it is
    interpolated linearly there, from at least ``LEAST`` coarse cells along each side, and one that has no more is not
    coarsened.
    """
    fitted, lacks = closure_card(scene.name, factor), ""
    if fitted is None or not of_factor(weights_name("local", scene.name), factor):
        lacks = f"no closure of {scene.name} at factor {factor}"
        if scene.name not in SCENES:
            return Choice(why=lacks)
    known, coarse = fitted or Card.own(scene.name), coarse_grid(scene.grid, factor)
    other, grid = lacks or known.beyond(scene, coarse), known.grid_beyond(scene.grid, coarse)
    if not grid and not other:
        return Choice("closure", "local")
    if not grid or known.taut:
        return Choice(why=other or grid)
    whole = coarse_grid(scene.grid, factor, LEAST) == scene.grid
    return Choice("similar" if other or whole else "closure", "bilinear", LEAST, other or grid)
