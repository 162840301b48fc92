"""The backend ``"miniature"``: coarse physics and an upscaler (Lee, Oh & Lee 2019), each by name."""

from collections.abc import Mapping
from typing import Any

from cloth_envs.arguments import as_whole, one_of, true_or_false
from cloth_envs.scene import Scene
from surrogates.miniature.choice import choose
from surrogates.miniature.coarse import CoarsePhysics
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
            in compression, fitted too). With neither this nor an upscaler given, ``"closure"`` and ``"local"`` where
            both are shipped for the scene, else, and if only one is given, ``"similar"`` and ``"bicubic"``. Small and
            thin cloths, which would tear with ``"local"``, are then interpolated linearly from at least 6 coarse cells
            along each side (``choice``).
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

    Raises:
        ValueError: a bad argument, or a scene that has no calibration or correction.
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
    ) -> None:
        cells = as_whole(factor)
        if cells not in (2, 3, 4):
            raise ValueError(f"factor must be 2, 3 or 4, got {factor!r}")
        factor, guard = cells, true_or_false("guard", guard)
        for name, options in {"factors": factors, "solver_kwargs": solver_kwargs}.items():
            if options is not None and not isinstance(options, Mapping):
                raise ValueError(f"{name} must be a dict, got {options!r}")
        least = 2
        if scaling is None and upscaler is None and solver == "explicit":
            scaling, upscaler, least = choose(scene, factor)
        self.factor, self.scaling, self.upscaler = factor, scaling or "similar", upscaler or "bicubic"
        coarse = CoarsePhysics(
            scene,
            num_envs=num_envs,
            factor=factor,
            least=least,
            scaling=self.scaling,
            factors=factors,
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
        usual = not isinstance(upscaling, Interpolation) and mends(scene, coarse.scene.grid)
        self.mend = usual if mend is None else true_or_false("mend", mend)
        super().__init__(coarse, upscaling, mend=self.mend, guard=guard, threads=threads)
