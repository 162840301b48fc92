"""Who takes part in a comparison: a backend, its keywords and a resolution."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from cloth_envs.backend import parse_backend
from cloth_envs.material import Material
from cloth_envs.places import check_backend_kwargs
from cloth_envs.registry import load_task
from cloth_envs.world import World

# Compared by default: backends and their keywords, at the scene's resolution.
USUAL: tuple[tuple[str, dict[str, Any]], ...] = (
    ("reference", {}),
    ("cnn", {}),
    ("miniature", {"factor": 2, "scaling": "closure", "upscaler": "local"}),
    ("miniature", {"factor": 4, "scaling": "closure", "upscaler": "local"}),
)


@dataclass(frozen=True)
class Entry:
    """One column of the comparison."""

    backend: str
    resolution: tuple[int, int]
    backend_kwargs: Mapping[str, Any] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """``reference 17x25``, and the keywords if there are any; of those that are words only the value."""
        given = self.backend_kwargs.items()
        extra = "".join(f" {value}" if isinstance(value, str) else f" {name}={value}" for name, value in given)
        return f"{self.backend} {self.resolution[0]}x{self.resolution[1]}{extra}"

    @property
    def curve(self) -> tuple[object, ...]:
        """What entries of one curve share: the backend and the keywords that are words, such as the solver."""
        return self.backend, *((n, v) for n, v in sorted(self.backend_kwargs.items()) if isinstance(v, str))

    def world(
        self, scene: str, material: Material | str | Mapping[str, float] | None, self_contact: bool | None = None
    ) -> World:
        """The scene with this entry's physics.

        Raises:
            ValueError: a bad backend, keyword, resolution or material, or self-contact where the physics has none.
        """
        return World(
            scene,
            backend=self.backend,
            backend_kwargs=dict(self.backend_kwargs),
            material=material,
            resolution=self.resolution,
            self_contact=self_contact,
        )


def read_resolution(text: str) -> tuple[int, int]:
    """``"33x49"`` as ``(33, 49)``. Raises ValueError: another form."""
    match = re.fullmatch(r"(\d+)\s*[xX]\s*(\d+)", text.strip())
    if match is None:
        raise ValueError(f"a resolution is written ROWSxCOLS, such as 33x49, got {text!r}")
    return int(match[1]), int(match[2])


def choose_entries(scene: str, *, backends: Sequence[str] = (), resolutions: Sequence[str] = ()) -> list[Entry]:
    """Every one of ``backends``, by default ``USUAL``, at its own resolution or at each of ``resolutions``.

    One is written ``NAME[@ROWSxCOLS][=JSON]``, such as ``reference@17x25={"refine": 2}``.

    Raises:
        ValueError, ImportError: an unknown scene, a bad backend, or a resolution in another form.
    """
    full = load_task(scene).resolution
    if not backends and not resolutions:
        return [Entry(name, full, options) for name, options in USUAL]
    shapes = [read_resolution(text) for text in resolutions] or [full]
    chosen = []
    for text in backends or ["reference"]:
        head, equals, options = text.partition("=")
        head, _, own = head.partition("@")
        name, given = parse_backend(head + equals + options)
        check_backend_kwargs(name, given, shell=True)
        chosen += [Entry(name, shape, given) for shape in ([read_resolution(own)] if own else shapes)]
    return list({entry.label: entry for entry in chosen}.values())
