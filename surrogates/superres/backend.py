"""The backend ``"mfsr"``: super-resolved cloth (after Chen et al. 2020), coarse physics and detail from a network.

It is a miniature at factor 4 whose upscaler is the network, for all else is the same: the coarse cloth, of the material
that the network was trained with, its own or the closure's, fine ones computed when they are read, handles, folds drawn
out of each other, what is remembered.
"""

from collections.abc import Mapping
from typing import Any

from cloth_envs.arguments import true_or_false
from cloth_envs.material import Material
from cloth_envs.registry import SCENES
from cloth_envs.scene import Scene
from surrogates.checkpoint import Checkpoint
from surrogates.miniature.backend import MiniatureBackend
from surrogates.miniature.choice import closure_card
from surrogates.miniature.coarse import coarse_grid
from surrogates.superres.features import SCALE
from surrogates.superres.network import divides, fitted_on, shipped

SOLVER = "explicit"  # of the coarse cloth in training, with self-contact where the scene has it
SPACING = 1.3  # times larger or smaller than in training that a side of a coarse cell may be


class MfsrBackend(MiniatureBackend):
    """Coarse physics at factor 4, super-resolved when the cloth is read; the usual miniature where no network fits.

    Args:
        scene: at full resolution. num_envs: members of the batch.
        guard: interpolate a cloth bicubically in frames in which the network would tear it; ``guarded`` tells the last
            frame's.
        threads: over members of the batch.
        solver: of the coarse cloth, as for ``backend="reference"``. solver_kwargs: its other options.
        strict: raise ValueError where the network was not trained, instead of being the usual miniature at factor 4, or
            of taking the network as it is for another material or physics.

    Raises:
        ValueError: a bad argument; ``strict``, and a scene, grid, material or physics that the network was not
            trained on.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        num_envs: int = 1,
        guard: bool = True,
        threads: int = 1,
        solver: str = SOLVER,
        solver_kwargs: Mapping[str, Any] | None = None,
        strict: bool = False,
    ) -> None:
        self._weights = shipped(scene.name, coarse_grid(scene.grid, SCALE)) if scene.name in SCENES else None
        self._lacks, self._other, scaling = lacks(scene, self._weights, solver), "", "similar"
        if self._weights is not None and not self._lacks:
            trained = fitted_on(self._weights)
            self._other, scaling = physics_beyond(scene, solver, trained["self_contact"]), trained["scaling"]
        why = self.beyond(scene.material)
        if true_or_false("strict", strict) and why:
            instead = "a plainer miniature" if self._lacks else "the network as it is"
            raise ValueError(f"strict=True: {why}: leave strict out for {instead}, or use the reference")
        chosen: Any = {} if self._lacks else {"scaling": scaling, "upscaler": "mfsr", "mend": False}
        super().__init__(scene, num_envs=num_envs, factor=SCALE, guard=guard, threads=threads, solver=solver,
                         solver_kwargs=solver_kwargs, strict=strict, **chosen)  # fmt: skip

    def beyond(self, material: Material) -> str:
        """Why a cloth of ``material`` is without the network or beyond what was trained; empty where it is neither."""
        if self._lacks or self._weights is None:
            return self._lacks
        trained = fitted_on(self._weights)["material"]
        other = [f"{key} {value:g}, trained on {trained[key]:g}" for key, value in material.as_dict().items()
                 if value != trained[key]]  # fmt: skip
        return ", ".join([*other[:2], *filter(None, [self._other])])


def lacks(scene: Scene, weights: Checkpoint | None, solver: str) -> str:
    """Why ``weights`` do not fit ``scene``, nor its coarse cloth of ``solver``; empty if they do."""
    if weights is None:
        return f"no super-resolution of {scene.name}"
    coarse = coarse_grid(scene.grid, SCALE)
    if not divides(coarse, scene.grid):
        return f"{scene.grid} is not {SCALE} times as fine as another grid"
    trained = fitted_on(weights)["spacing"]
    sides = coarse.row_spacing, coarse.col_spacing
    if any(not 1 / SPACING < side / trained < SPACING for side in sides):
        down, along = (f"{1e3 * side:.0f}" for side in sides)
        told = down if down == along else f"{down} x {along}"
        return f"coarse cells of {told} mm, trained on {1e3 * trained:.0f} mm"
    if fitted_on(weights)["scaling"] == "similar":
        return ""
    closure = closure_card(scene.name, SCALE)  # which other solvers do not have
    return solver_beyond(solver) or (closure.scene_beyond(scene) or closure.finer(coarse) if closure else "")


def solver_beyond(solver: str) -> str:
    """Why the network was not trained on coarse cloths of ``solver``; empty if it was."""
    return "" if solver == SOLVER else f"solver {solver!r}, trained on {SOLVER!r}"


def physics_beyond(scene: Scene, solver: str, self_contact: bool) -> str:
    """Why the network was not trained on the coarse cloth's physics; empty if it was."""
    if told := solver_beyond(solver):
        return told
    if (scene.self_contact is not None) == self_contact:
        return ""
    return "no self-contact, trained with it" if self_contact else "self-contact, trained without it"
