"""The backend ``"cnn"``: the cell of Zhao 2024, fitted, stepped by the compiled kernels or in torch.

Learned are dimensionless numbers that multiply what the scene's material says (1 where the cell has found the law),
so weights belong to no one stiffness and mass. On a net of particles they are alpha, beta and gamma of every
neighbour and the weight's direction and size (39 numbers); on a sheet what stretch, shear, bending, damping and
gravity are of the material's (5 numbers, identified class of edges by class of edges). Air drag, wind, pressure,
bodies with friction, handles, the step and geometry are plugged in, as in the paper's fig. 2.

The simulator of a net changes velocities in place, row by row, and a convolution reads those before the step: on nets
frames are not those of ``"reference"`` (docs/networks.md has by how much), whatever was learned.

On sheets the numbers are 1 to 1e-12 and frames are those of ``"reference"`` to the bit, at its speed; see
``training/bench/papers/large_step.py`` for why several cells cannot take a larger step.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from cloth_envs.arguments import one_of
from cloth_envs.extras import missing
from cloth_envs.physics.particles.solver import ParticleSolver
from cloth_envs.scene import Scene
from surrogates.cell.compiled import SHEET, CellNet, CellSheet, dimensional
from surrogates.checkpoint import load

if TYPE_CHECKING:
    from surrogates.cell.card import CellCard
    from surrogates.cell.sheet import Force

ENGINES = ("compiled", "torch")
EMULATED = "emulated"  # a card whose threads take turns on this processor
PARTICLES = "cnn_particles"  # the default weights of nets; those of a sheet are cnn_<scene>


def cnn(
    scene: Scene,
    *,
    num_envs: int = 1,
    threads: int = 1,
    dtype: str = "float32",
    weights: str | None = None,
    engine: str = "compiled",
    device: str = "cpu",
    forces: "Sequence[Force]" = (),
) -> "ParticleSolver | CellSheet | CellCard":
    """The physics-embedded cell of Zhao 2024, fitted, in place of the solver's inner forces.

    Args:
        scene: a sheet, or a net of particles (presets of Zhao 2024).
        num_envs: members of the batch. threads: over them, of the compiled engine.
        dtype: ``"float32"`` or ``"float64"``.
        weights: a checkpoint's name; default ``"cnn_particles"`` or ``"cnn_<scene>"``.
        engine: ``"compiled"``, or ``"torch"``, whose frames as tensors are ``surrogates.cell.rollout``'s.
        device: ``"cpu"``, or ``"cuda"``: a sheet's compiled engine is then one kernel a frame for thousands of cloths,
            without self-contact, and its state lies on the card (``"emulated"`` runs that kernel thread by thread on
            this processor, slowly, to test it); ``engine="torch"`` computes on any device of torch's.
        forces: plugged in to the torch engine, ``f(positions, velocities) -> (B, 3, H, W)`` [N] in tensors.

    Raises:
        ValueError: a bad argument, weights that there are not, plugged-in forces without ``engine="torch"``, or a
            device that can't be used.
        ImportError: what a device needs is missing; the extra that brings it is named.
    """
    one_of("engine", engine, ENGINES)
    if not isinstance(forces, Sequence) or not all(map(callable, forces)):
        raise ValueError(f"forces must be a list of functions f(positions, velocities), got {forces!r}")
    options: dict[str, Any] = {"num_envs": num_envs, "threads": threads, "dtype": dtype}
    net: Callable[..., ParticleSolver] = CellNet
    sheet: type[CellSheet] = CellSheet
    if engine == "torch":
        try:
            from surrogates.cell.engine import TorchNet, TorchSheet, usable
        except ImportError as error:
            raise ImportError(missing('engine="torch"', error)) from error
        net, sheet, options = TorchNet, TorchSheet, options | {"device": usable(device), "forces": forces}
    elif forces:
        raise ValueError('forces belong to engine="torch": add it, or leave them out')
    name = weights or (PARTICLES if scene.particles is not None else f"cnn_{scene.name.lower()}")
    arrays = load(name).arrays
    if ("factors" in arrays) == (scene.particles is not None):
        of = "a sheet" if "factors" in arrays else "a net of particles"
        raise ValueError(f"weights {name!r} are of {of}, this scene is not: leave weights out")
    if engine == "compiled" and device != "cpu":
        return _on_card(scene, arrays, num_envs=num_envs, dtype=dtype, device=device)
    if scene.particles is not None:
        return net(scene, dimensional(scene, arrays), **options)
    return sheet(scene, factors_of(arrays), **options)


def factors_of(arrays: Mapping[str, np.ndarray]) -> dict[str, float]:
    """A sheet's numbers by their names."""
    return dict(zip(SHEET, arrays["factors"].tolist(), strict=True))


def _on_card(scene: Scene, arrays: Mapping[str, np.ndarray], *, dtype: str, **options: Any) -> "CellCard":
    """A sheet's cell on a card. Raises ValueError, ImportError: what it can't be, or what is missing."""
    if scene.particles is not None:
        raise ValueError('a net of particles is on a device with engine="torch" only: add it, or leave device out')
    if dtype != "float32":
        raise ValueError(f'dtype={dtype!r}: a card computes in float32; leave dtype out, or add engine="torch"')
    try:
        from surrogates.cell.card import CellCard
        from surrogates.cell.engine import usable_card
    except ImportError as error:
        raise ImportError(missing(f"device={options['device']!r}", error, "gpu")) from error
    if options["device"] == EMULATED:
        options["device"] = "cpu"
    else:
        usable_card(options["device"])
    return CellCard(scene, factors_of(arrays), **options)
