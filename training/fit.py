"""The one training loop: Adam under a schedule, that goes on bit for bit where it was stopped."""

import json
import math
from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
import torch

from cloth_envs.files import check_folder, check_zip, reading, write_bytes
from cloth_envs.progress import progress

Rate = Callable[[int], float]  # of a step; the first one is 0


def cosine(rate: float, steps: int, *, least: float = 0.0, warm: int = 0) -> Rate:
    """From ``rate`` down along half a cosine, plus ``least`` of it; over the first ``warm`` steps it rises to that."""

    def at(step: int) -> float:
        step += warm > 0  # a step of no rate would be lost
        rise = min(1.0, step / warm) if warm else 1.0
        return rate * rise * (0.5 * (1 + math.cos(math.pi * step / steps)) + least)

    return at


def halved(rate: float, steps: int, times: int = 10) -> Rate:
    """``rate``, halved after every ``1 / times`` of the steps."""
    return lambda step: rate * 0.5 ** (step // max(1, steps // times))


class Best:
    """The weights of a network at which ``check()`` was the least, looked at every so many steps."""

    def __init__(self, check: Callable[[], float], every: int) -> None:
        self.check, self.every = check, every
        self.least, self.weights = math.inf, dict[str, Any]()

    def look(self, net: torch.nn.Module) -> None:
        found = self.check()
        if found < self.least:
            self.least, self.weights = found, deepcopy(net.state_dict())


@dataclass(frozen=True)
class Kept:
    """Where a training is kept after every so many steps and the last one; ``mark`` tells its recipe and data."""

    path: Path
    mark: str
    every: int = 500

    def read(self) -> dict[str, Any]:
        """What was written last, or nothing. Raises ValueError: damaged, or of another training."""
        if not self.path.is_file():
            return {}
        with reading(self.path, "remove it to start again"):
            check_zip(self.path)  # torch reads past it
            parts: dict[str, Any] = torch.load(self.path, weights_only=True)
            mark = parts["mark"]
        if mark != self.mark:
            raise ValueError(f"{self.path} is of another recipe or other data: remove it to start again")
        return parts

    def write(self, **parts: Any) -> None:
        """Replace the file, when the new one is whole. Raises OSError: it can't be written; the old one stays."""
        check_folder(self.path.parent)
        content = BytesIO()
        torch.save({"mark": self.mark, **parts}, content)
        write_bytes(self.path, content.getvalue())


def fit(
    net: torch.nn.Module,
    loss: Callable[[int], torch.Tensor],
    steps: int,
    rate: Rate,
    *,
    label: str = "",
    clip: float | None = None,
    kept: Kept | None = None,
    rng: np.random.Generator | None = None,
    best: Best | None = None,
    betas: tuple[float, float] = (0.9, 0.999),
) -> float:
    """Change ``net`` by Adam until ``steps`` are done. Returns the processor's seconds for all of them.

    ``loss`` is of a step: its batch follows from the step's number and from ``rng``, the generator that it draws from.
    ``label`` is of the progress, ``clip`` the largest norm of a gradient, ``kept`` where to go on, ``betas`` Adam's;
    the weights of ``best`` are left in the end instead of the last ones. Parameters that require no gradient stay as
    they are.

    Raises:
        ValueError: ``kept`` is of another training.
    """
    optimiser = torch.optim.Adam([p for p in net.parameters() if p.requires_grad], betas=betas)
    parts = kept.read() if kept is not None else {}
    done, spent = parts.get("done", 0), parts.get("spent", 0.0)
    if parts:
        net.load_state_dict(parts["net"])
        optimiser.load_state_dict(parts["optimiser"])
        if rng is not None:
            rng.bit_generator.state = json.loads(parts["rng"])
        if best is not None:
            best.least, best.weights = parts["best"]
    elif best is not None:
        best.look(net)
    begin = process_time() - spent
    for step in progress(range(done, steps), label, steps, unit="step", done=done):
        for group in optimiser.param_groups:
            group["lr"] = rate(step)
        optimiser.zero_grad()
        loss(step).backward()  # type: ignore[no-untyped-call]
        if clip is not None:
            torch.nn.utils.clip_grad_norm_(net.parameters(), clip)
        optimiser.step()
        done, spent, last = step + 1, process_time() - begin, step + 1 == steps
        if best is not None and (last or done % best.every == 0):
            best.look(net)
        if kept is not None and (last or done % kept.every == 0):
            kept.write(
                net=net.state_dict(), optimiser=optimiser.state_dict(), done=done, spent=spent,
                rng=rng and json.dumps(rng.bit_generator.state), best=best and (best.least, best.weights),
            )  # fmt: skip
    if best is not None and best.weights:
        net.load_state_dict(best.weights)
    return spent
