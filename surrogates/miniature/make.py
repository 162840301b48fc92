"""What ``backend="miniature"`` builds: for a few members compiled, for thousands on a device."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from cloth_envs.arguments import one_of
from cloth_envs.extras import missing
from cloth_envs.scene import Scene
from surrogates.miniature.backend import MiniatureBackend
from surrogates.upscale.protocol import Interpolation

if TYPE_CHECKING:
    from surrogates.miniature.on_device import MiniatureOnDevice

NOT_ON_DEVICE = ("fc", "hdnn", "mfsr")  # upscalers


def miniature(
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
    device: str | None = None,
) -> "MiniatureBackend | MiniatureOnDevice":
    """Coarse physics and an upscaler; the arguments are those of ``MiniatureBackend`` and ``device``.

    On a ``device``, ``"cuda"``, thousands of coarse cloths are stepped by one kernel, and what is read of the fine ones
    is computed there, in torch. Edges are not mended there, the network is not guarded, the cloth does not keep out of
    itself; what was asked for and is not there is left out for what is plainer: ``surrogate`` tells. ``"cpu"`` emulates
    the card, slowly, to test it.

    Raises:
        ValueError: see ``MiniatureBackend``; a solver or mending on a device, ``strict`` and what a device does not
            have, or a device that can't be used.
        ImportError: what a device needs is missing; the extra that brings it is named.
    """
    usual: dict[str, Any] = {"factor": factor, "scaling": scaling, "factors": factors, "strict": strict}
    if device is None:
        own: dict[str, Any] = {"mend": mend, "guard": guard, "correction": correction, "threads": threads}
        return MiniatureBackend(
            scene, num_envs=num_envs, upscaler=upscaler, solver=solver, solver_kwargs=solver_kwargs, **own, **usual
        )
    if solver != "explicit" or solver_kwargs or mend:
        raise ValueError(
            "on a device a miniature has the explicit solver without options and mends no edges: "
            "leave solver, solver_kwargs and mend out, or device"
        )
    try:
        from surrogates.cell.engine import usable_card
        from surrogates.miniature.on_device import MiniatureOnDevice
    except ImportError as error:
        raise ImportError(missing(f"device={device!r}", error, "gpu")) from error
    lacking = [] if correction is None else [f"correction={one_of('correction', correction, ['learned'])!r}"]
    if isinstance(upscaler, str) and (upscaler in NOT_ON_DEVICE or ":" in upscaler):
        lacking.append(f"upscaler={upscaler!r}")
        upscaler = "bicubic"
    if strict and lacking:
        raise ValueError(f"strict=True: a device has no {' and no '.join(lacking)}: leave strict or device out")
    plain = MiniatureBackend(scene, upscaler=upscaler, threads=threads, **usual)
    lacking += ["mended edges"] if plain.mend else []
    lacking += ["a guard"] if guard and not isinstance(plain.upscaling, Interpolation) else []
    without = f"on a device without {' and '.join(lacking)}" if lacking else ""
    return MiniatureOnDevice(plain, num_envs=num_envs, device=usable_card(device), without=without)
