"""The backend ``"miniature"``: coarse physics and an upscaler (Lee, Oh & Lee 2019), each by name."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cloth_envs.arguments import as_whole, one_of, true_or_false
from cloth_envs.material import Material
from cloth_envs.scene import Scene
from cloth_envs.state import State
from surrogates.miniature.choice import choose, closure_card
from surrogates.miniature.coarse import CoarsePhysics, coarse_grid
from surrogates.miniature.correction import Correction, shipped
from surrogates.miniature.mending import mends
from surrogates.miniature.upscaled import Upscaled
from surrogates.upscale.protocol import Interpolation, make_upscaler


class MiniatureBackend(Upscaled):
    """A reference solver on a grid ``factor`` times coarser, upscaled when the cloth is read.

    Args:
        scene: at full resolution. num_envs: members of the batch.
        factor: 2, 3 or 4, how many times fewer cells along each side.
        scaling: ``"similar"`` (the sheet's own material), ``"seed"`` (the paper's spring constants, ``factor^2``
            times too stiff), ``"calibrated"`` (factors fitted per scene), ``"closure"`` (those and a law of springs
            in compression, fitted too), ``"rule"`` (two of the factors, the same for all scenes). With neither this
            nor an upscaler given, ``"closure"`` and ``"local"`` where their card holds (``card``), else what is
            plainer (``choice``): ``surrogate`` tells. If only one is given, ``"similar"`` and ``"bicubic"``.
        factors: of a calibration of your own, ``{material property: multiplier}``, instead of the shipped ones.
        upscaler: an interpolation, ``"bilinear"``, ``"biquadratic"`` or ``"bicubic"``, a network by name, or
            ``"module:Class"``.
        mend: bring the fine cloth's edges to their lengths at rest (``mending``); by default after a network, where the
            cloth folds, and not where it is taut or soft.
        guard: interpolate a cloth bicubically in frames in which the network would tear it; ``guarded`` tells the last
            frame's.
        correction: ``"learned"``, a network that corrects the coarse cloth after every frame (``correction``).
        solver: of the coarse cloth, as for ``backend="reference"``. threads: over members of the batch.
        solver_kwargs: its other options.
        strict: raise ValueError where a fit does not hold, instead of taking what is plainer.

    Raises:
        ValueError: a bad argument, or a scene that has no calibration or correction; ``strict``, and a scene or
            material beyond the closure's card.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        num_envs: int = 1,
        factor: int = 2,
        scaling: str | None = None,
        factors: Mapping[str, float] | None = None,
        upscaler: str | None = None,
        mend: bool | None = None,
        guard: bool = True,
        correction: str | None = None,
        threads: int = 1,
        solver: str = "explicit",
        solver_kwargs: Mapping[str, Any] | None = None,
        strict: bool = False,
    ) -> None:
        cells = as_whole(factor)
        if cells not in (2, 3, 4):
            raise ValueError(f"factor must be 2, 3 or 4, got {factor!r}")
        factor, guard = cells, true_or_false("guard", guard)
        for name, options in {"factors": factors, "solver_kwargs": solver_kwargs}.items():
            if options is not None and not isinstance(options, Mapping):
                raise ValueError(f"{name} must be a dict, got {options!r}")
        least, why, fitted = 2, "", closure_card(scene.name, factor)
        usual = scaling is None and upscaler is None and solver == "explicit"
        if usual:
            scaling, upscaler, least, why = choose(scene, factor)
        elif scaling == "closure" and factors is None and fitted is not None:
            why = fitted.beyond(scene, coarse_grid(scene.grid, factor))
        if true_or_false("strict", strict) and why:
            raise ValueError(f"strict=True: {why}: leave strict out for a plainer miniature, or use the reference")
        self._strict, self._why, self._usual = strict, why, usual
        self._card = fitted if scaling == "closure" and factors is None else None
        self.factor, self.scaling, self.upscaler = factor, scaling or "similar", upscaler or "bicubic"
        coarse = CoarsePhysics(
            scene,
            num_envs=num_envs,
            factor=factor,
            least=least,
            scaling=self.scaling,
            factors=factors,
            card=self._card if usual else None,
            solver=solver,
            options={"threads": threads, **(solver_kwargs or {})},
        )
        if correction is not None:
            one_of("correction", correction, ["learned"])
            if self.scaling != "closure":
                wanted = 'scaling="closure"'
                raise ValueError(
                    f"correction={correction!r} was trained on {wanted}, got {self.scaling!r}: pass {wanted}"
                )
            coarse.correct(Correction(coarse.scene, shipped(scene.name, factor)))
        upscaling = make_upscaler(self.upscaler, coarse.scene, scene, factor)
        gains = not isinstance(upscaling, Interpolation) and mends(scene, coarse.scene.grid)
        self.mend = gains if mend is None else true_or_false("mend", mend)
        self._told = np.full(num_envs, self.plain(scene.material), object)
        super().__init__(coarse, upscaling, mend=self.mend, guard=guard, threads=threads)

    @property
    def surrogate(self) -> np.ndarray:
        """Why each member is plainer than usual or beyond its card, ``(B,)`` text; empty where neither is so."""
        return self._told.copy()

    def check_material(self, material: Material) -> None:
        """Refuse a fine material whose coarse one can't be stepped or, ``strict``, that is beyond the card.

        Raises:
            ValueError: says what to change.
        """
        if self._strict and (why := self.beyond(material)):
            raise ValueError(f"strict=True: {why}: leave strict out, or narrow the material")
        super().check_material(material)

    def reset(
        self, state: State, materials: Sequence[Material] | None = None, which: Sequence[int] | None = None
    ) -> None:
        """Start from ``state``; see ``Backend.reset``."""
        super().reset(state, materials, which)
        chosen = [self.scene.material] * state.batch if materials is None else materials
        for i, material in zip(range(state.batch) if which is None else which, chosen, strict=True):
            self._told[i] = self.plain(material)

    def beyond(self, material: Material) -> str:
        """Why a fit does not hold for a cloth of ``material``; empty where it does, or where there is none."""
        return self._why or (self._card.material_beyond(material) if self._card is not None else "")

    def plain(self, material: Material) -> str:
        """Why a cloth of ``material`` is plainer than usual or beyond its card; empty where it is neither."""
        why = self.beyond(material)
        plainer = self._usual and self._card is not None and self._card.material_beyond(material)
        own = "similar" if plainer else self.scaling
        return f"{own}, {self.upscaler}: {why}" if why else ""

    @property
    def made_of(self) -> str:
        """Scaling and upscaler in words."""
        return f"{self.scaling}, {self.upscaler}"
