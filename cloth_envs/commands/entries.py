"""Who takes part in a comparison: a backend, its keywords and a resolution."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from cloth_envs.material import Material
from cloth_envs.registry import load_backend, load_task
from cloth_envs.world import World

# Compared by default: backends and their keywords, at the scene's resolution.
USUAL: tuple[tuple[str, dict[str, Any]], ...] = (
    ("reference", {}),
    ("cnn", {}),
    ("miniature", {"factor": 2, "scaling": "closure", "upscaler": "local"}),
    ("miniature", {"factor": 4, "scaling": "closure", "upscaler": "local"}),
)
# Same mesh and energy as the full resolution, a quarter of its step, in double precision.
TRUTH_KWARGS = {"dtype": "float64", "refine": 4}


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

    def world(self, scene: str, material: Material | str | Mapping[str, float] | None) -> World:
        """The scene with this entry's physics.

        Raises:
            ValueError: a bad backend, keyword, resolution or material.
        """
        return World(
            scene,
            backend=self.backend,
            backend_kwargs=dict(self.backend_kwargs),
            material=material,
            resolution=self.resolution,
        )


def read_resolution(text: str) -> tuple[int, int]:
    """``"33x49"`` as ``(33, 49)``.

    Raises:
        ValueError: another form.
    """
    match = re.fullmatch(r"(\d+)\s*[xX]\s*(\d+)", text.strip())
    if match is None:
        raise ValueError(f"a resolution is written ROWSxCOLS, such as 33x49, got {text!r}")
    return int(match[1]), int(match[2])


def read_object(text: str, what: str) -> dict[str, Any]:
    """A JSON object.

    Raises:
        ValueError: not JSON, or not an object.
    """
    try:
        value = json.loads(text)
    except json.JSONDecodeError as error:
        raise ValueError(f"{what} must be JSON such as '{{\"refine\": 2}}', got {text!r} ({error})") from error
    if not isinstance(value, dict):
        raise ValueError(f"{what} must be a JSON object such as '{{\"refine\": 2}}', got {text!r}")
    return value


def read_entry(text: str, full: tuple[int, int]) -> Entry:
    """``NAME[@ROWSxCOLS][:JSON]``, such as ``reference@17x25:{"refine": 2}``.

    Raises:
        ValueError: another form, or an unknown backend.
    """
    head, _, options = text.partition(":")
    name, _, resolution = head.partition("@")
    load_backend(name)
    shape = read_resolution(resolution) if resolution else full
    return Entry(name, shape, read_object(options, "an entry's keywords") if options else {})


def choose_entries(
    scene: str, *, backends: Sequence[str] = (), resolutions: Sequence[str] = (), entries: Sequence[str] = ()
) -> list[Entry]:
    """Every backend at every resolution, then ``entries``; by default ``USUAL``.

    Raises:
        ValueError: an unknown scene or backend, or a resolution in another form.
    """
    full = load_task(scene).resolution
    shapes = [read_resolution(text) for text in resolutions]
    if not shapes and not backends and not entries:
        return [Entry(name, full, options) for name, options in USUAL]
    shapes = shapes or [full]
    names = list(backends) or (["reference"] if resolutions or not entries else [])
    for name in names:
        load_backend(name)
    chosen = [Entry(name, shape) for name in names for shape in shapes]
    chosen += [read_entry(text, full) for text in entries]
    return list({entry.label: entry for entry in chosen}.values())
