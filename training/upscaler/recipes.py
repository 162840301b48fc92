"""How the published networks are trained here: one frozen recipe each, for a minute or two of one core.

Lee et al. 2019 train for eight hours on a GPU, in batches of 50,000 at a rate of 1e-4.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from training.cache import cache_folder

SCENES = ("Curtain", "Flag", "Collision")
FACTORS = (2, 3, 4)
SHAPES = ((4, 32), (3, 64), (4, 64), (5, 64), (4, 128))  # of table 5


@dataclass(frozen=True)
class Recipe:
    """A network and its training by Adam, whose rate falls along half a cosine.

    ``start="bilinear"``: twelve units of each hidden layer pass the corners on, so that the network starts as bilinear
    interpolation, and stay as they are; ``"random"``: all units start at random.
    """

    scene: str
    factor: int = 2
    preset: str = "lee2019"
    inputs: str = "oracle"  # or "real", "triangles": see upscaler.data
    features: str = "frames"  # or "positions", "velocities"
    layers: int = 4  # hidden ones: U of U*FC-V
    width: int = 64  # V
    start: str = "bilinear"
    steps: int = 6000
    batch: int = 1024
    rate: float = 2e-3
    seed: int = 0


def _recipes() -> Iterator[tuple[str, Recipe]]:
    for scene in SCENES:
        stem, plain = f"fc-{scene.lower()}", Recipe(scene)
        for factor in FACTORS:
            yield f"{stem}-{factor}", replace(plain, factor=factor)
            yield f"{stem}-{factor}-real", replace(plain, factor=factor, inputs="real")
        for layers, width in SHAPES:
            if (layers, width) != (plain.layers, plain.width):
                yield f"{stem}-2-{layers}x{width}", replace(plain, layers=layers, width=width)
        yield f"{stem}-2-real-4x128", replace(plain, inputs="real", width=128)
        yield f"{stem}-2-random", replace(plain, start="random")
        for factor in (2, 4):
            triangle = replace(plain, factor=factor, inputs="triangles", features="positions", steps=4000)
            yield f"hdnn-{scene.lower()}-{factor}", triangle
    for features in ("positions", "velocities"):
        yield f"fc-flag-2-{features}", Recipe("Flag", features=features)


RECIPES = dict(_recipes())


def work_folder() -> Path:
    """Of checkpoints; its ``weights`` are those trained here."""
    return cache_folder("upscalers")
