"""From the coarse cloth to the fine one: what an upscaler is, and interpolation."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
from _minicloth_kernels import PatchNet, Resample

from cloth_envs.arguments import one_of
from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.naming import resolve
from cloth_envs.resample import Resampler
from cloth_envs.scene import Scene
from cloth_envs.state import State

INTERPOLATIONS = {"bilinear": "linear", "biquadratic": "quadratic", "bicubic": "cubic"}
# name -> "module:class", resolved on use; built as ``Class(coarse scene, fine scene, factor)``.
LEARNED: dict[str, str] = {
    "fc": "surrogates.upscale.published:FullyConnected",
    "hdnn": "surrogates.upscale.published:HierarchicalDnn",
    "local": "surrogates.upscale.local:Local",
    "mfsr": "surrogates.superres.network:SuperResolution",
    "ridge": "surrogates.upscale.local:Ridge",
}


Method = TypeVar("Method", bound=Callable[..., Any])
_COMPILED: set[object] = set()


def compiled(method: Method) -> Method:
    """Marks ``positions`` or ``velocities`` of an upscaler that ``recipe`` or ``speeds`` tell as well.

    Then the compiled frame does what they say; whatever overrides the method is called instead.
    """
    _COMPILED.add(method)
    return method


def is_compiled(method: Callable[..., Any]) -> bool:
    """Whether a bound method is one that was marked."""
    return getattr(method, "__func__", None) in _COMPILED


class Recipe(NamedTuple):
    """From coarse to fine positions: a network with biases ``(B, n)``, then interpolation; None where there is none."""

    net: PatchNet | None
    bias: np.ndarray
    grids: Resample | None


NOTHING = Recipe(None, np.zeros((0, 0), np.float32), None)


class Upscaler(ABC):
    """Fine fields ``(B, 3, H, W)`` float32 from ``history``: the last ``frames`` coarse states, the newest last.

    Args:
        coarse, fine: the scene on both grids.
        factor: how many times fewer cells the coarse one has along each side.

    Attributes:
        bicubic: interpolation of a coarse field, which learned upscalers start from or fall back to.
        recipe: what compiled ``positions`` do.
        speeds: what compiled ``velocities`` do.
        kind: of the interpolation of velocities, one of ``resample.KINDS``.
        half: the grid that a network of ``recipe`` gives, where interpolation goes on from there.
        threads: over members of the batch, for those that use them.
        torn: the strain of an edge over which ``guard`` takes bicubic interpolation instead.
    """

    frames = 1
    threads = 1
    torn = 0.5
    kind = "cubic"
    half: Grid | None = None
    recipe = NOTHING

    def __init__(self, coarse: Scene, fine: Scene, factor: float) -> None:
        self.coarse, self.fine, self.factor = coarse, fine, factor
        self.bicubic = Resampler(coarse.grid, fine.grid)
        self.speeds = self.bicubic.kernel

    def set_materials(self, which: Sequence[int], materials: Sequence[Material]) -> None:  # noqa: B027  (few see any)
        """Members ``which`` of the batch are of these (fine) materials from now on."""

    @abstractmethod
    def positions(self, history: Sequence[State]) -> np.ndarray:
        """Positions [m] at the newest state."""

    @compiled
    def velocities(self, history: Sequence[State]) -> np.ndarray:
        """Velocities [m/s] at the newest state; bicubic interpolation if it has no better ones."""
        return self.bicubic(history[-1].velocities)


class RememberingUpscaler(Upscaler):
    """An upscaler whose answers depend on earlier ones.

    It is asked at every frame, once for positions and then once for velocities, where others are asked only for what is
    read. What it remembers has a leading axis of the batch.
    """

    @abstractmethod
    def reset(self, which: Sequence[int], history: Sequence[State]) -> None:
        """Members ``which`` begin anew at ``history``, that of the whole batch."""

    @property
    @abstractmethod
    def memory(self) -> dict[str, np.ndarray]:
        """What decides the next answers beyond the history."""

    @abstractmethod
    def recall(self, memory: Mapping[str, np.ndarray]) -> None:
        """Take back, after a ``reset`` of the whole batch, what ``memory`` held."""


class Interpolation(Upscaler):
    """Separable interpolation of positions and velocities, the same for every material."""

    def __init__(self, coarse: Scene, fine: Scene, factor: float, *, kind: str = "cubic") -> None:
        super().__init__(coarse, fine, factor)
        self.kind, self._resample = kind, Resampler(coarse.grid, fine.grid, kind)
        self.speeds = self._resample.kernel
        self.recipe = NOTHING._replace(grids=self.speeds)

    @compiled
    def positions(self, history: Sequence[State]) -> np.ndarray:
        return self._resample(history[-1].positions)

    @compiled
    def velocities(self, history: Sequence[State]) -> np.ndarray:
        return self._resample(history[-1].velocities)


def make_upscaler(name: str, coarse: Scene, fine: Scene, factor: int) -> Upscaler:
    """The upscaler ``name``, or ``"module:Class"``, of a pair of scenes.

    Raises:
        ValueError: an unknown name (the nearest match is named), one without weights for this scene, or a class that is
            no upscaler.
    """
    if not isinstance(name, str) or ":" not in name:
        one_of("upscaler", name, (*INTERPOLATIONS, *LEARNED, "module:Class"))
    if name in INTERPOLATIONS:
        return Interpolation(coarse, fine, factor, kind=INTERPOLATIONS[name])
    learned: Callable[[Scene, Scene, int], Upscaler] = resolve(LEARNED.get(name, name))
    try:
        made = learned(coarse, fine, factor)
    except TypeError as error:
        raise ValueError(f"upscaler {name!r} can't be built as Class(coarse, fine, factor): {error}") from error
    if not isinstance(made, Upscaler):
        raise ValueError(f"upscaler {name!r} is no surrogates.upscale.protocol.Upscaler: derive the class from it")
    return made
