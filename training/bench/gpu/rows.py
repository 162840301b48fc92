"""The rows of ``minicloth bench gpu``, and the tables made of them."""

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class GpuRow:
    """Vector environments by random actions, observations and rewards included.

    Attributes:
        where: ``"card"`` or ``"processor"``; device: its name. threads: of a processor.
        ms_step: a step of all members. ms_kernel: of that the backend's frame alone. steps: members' steps a second.
        substeps: of a frame, mean over members.
        of_peak: operations that the law asks for, each edge once, over what the card's FP32 units can do in that time.
        of_shared: what vertices read and write in shared memory over what it can move.
        joules: of the card, for a million steps; NaN where nobody tells.
    """

    scene: str
    backend: str
    rows: int
    cols: int
    members: int
    where: str
    device: str
    threads: int
    ms_step: float
    ms_kernel: float
    steps: float
    substeps: float
    of_peak: float
    of_shared: float
    joules: float


@dataclass(frozen=True)
class EqualRow:
    """A card's frames beside the processor's in float32, from equal states by equal actions, over the cloth's length.

    Attributes:
        rms, largest: distance of vertices after ``frames`` [% of length]. chaos, chaos_largest: those of the
            processor's own float32 from its float64. failures_alike: whether the same members failed.
        energy: kinetic energy over the processor's, mean of all members of an episode of ``episode`` frames; beside it
            what two halves of the processor's members differ by (``energy_floor``).
    """

    scene: str
    device: str
    members: int
    frames: int
    rms: float
    largest: float
    chaos: float
    chaos_largest: float
    failures_alike: bool
    episode: int
    energy: float
    energy_floor: float


@dataclass(frozen=True)
class SoundRow:
    """Random actions on a card: members' steps, and what ended episodes."""

    scene: str
    device: str
    members: int
    steps: int
    overstretch: int
    energy: int
    nonfinite: int
    wrong: int


@dataclass(frozen=True)
class LearnRow:
    """An update of PPO: seconds and steps since its start, and the mean reward a frame."""

    scene: str
    device: str
    members: int
    update: int
    seconds: float
    steps: int
    reward: float


def speed_table(rows: Sequence[GpuRow]) -> str:
    """A line for every row."""
    head = ("scene", "backend", "grid", "members", "on", "ms/step", "kernel", "steps/s", "substeps", "FP32", "shared")
    lines = [" ".join(f"{word:>12}" for word in head)]
    for r in rows:
        on = r.where if r.where == "card" else f"{r.threads} thread{'s' * (r.threads > 1)}"
        shares = ("", "") if r.where != "card" else (f"{r.of_peak:.0%}", f"{r.of_shared:.0%}")
        words = (
            *(r.scene, r.backend, f"{r.rows}x{r.cols}", str(r.members), on, f"{r.ms_step:.2f}", f"{r.ms_kernel:.2f}"),
            *(f"{r.steps:,.0f}", f"{r.substeps:.0f}", *shares),
        )
        lines.append(" ".join(f"{word:>12}" for word in words))
    return "\n".join(lines)


def equal_table(rows: Sequence[EqualRow]) -> str:
    """A line for every scene."""
    lines = ["scene         rms %   largest %   chaos: rms %   largest %   failures alike   energy (floor)"]
    lines += [
        f"{r.scene:<10} {r.rms:8.1e} {r.largest:11.1e} {r.chaos:14.1e} {r.chaos_largest:11.1e} "
        f"{'yes' if r.failures_alike else 'NO':>16} {r.energy:9.3f} ({r.energy_floor:.3f})"
        for r in rows
    ]
    return "\n".join(lines)


def sound_table(rows: Sequence[SoundRow]) -> str:
    """A line for every scene, and their sum."""
    lines = ["scene             steps   overstretch   energy   non-finite   wrong"]
    names = ("steps", "overstretch", "energy", "nonfinite", "wrong")
    for scene, *found in [*((r.scene, *(getattr(r, n) for n in names)) for r in rows)]:
        lines.append(f"{scene:<10} {found[0]:12,} {found[1]:13} {found[2]:8} {found[3]:12} {found[4]:7}")
    total = [sum(getattr(r, n) for r in rows) for n in names]
    lines.append(f"{'all':<10} {total[0]:12,} {total[1]:13} {total[2]:8} {total[3]:12} {total[4]:7}")
    return "\n".join(lines)


def learn_table(rows: Sequence[LearnRow]) -> str:
    """Some updates of each training."""
    lines = ["scene      members  update  seconds       steps  reward   on"]
    for trained in dict.fromkeys((r.scene, r.device) for r in rows):
        mine = [r for r in rows if (r.scene, r.device) == trained]
        shown = {0, len(mine) // 8, len(mine) // 4, len(mine) // 2, len(mine) - 1}
        lines += [
            f"{r.scene:<10} {r.members:7} {r.update:7} {r.seconds:8.1f} {r.steps:11,} {r.reward:7.3f}   {r.device}"
            for i, r in enumerate(mine)
            if i in shown
        ]
    return "\n".join(lines)
