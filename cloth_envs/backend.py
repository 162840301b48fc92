"""The protocol that every physics obeys, and the factory that finds one by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from inspect import signature
from typing import Any, Protocol

import numpy as np

from cloth_envs import registry
from cloth_envs.material import Material
from cloth_envs.naming import unknown_name
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State


class Backend(Protocol):
    """Physics for a batch of cloths of one scene.

    A backend is built as ``BackendClass(scene, **backend_kwargs)``. It owns its state: callers read
    ``state`` and copy what they keep.
    """

    scene: Scene

    @property
    def state(self) -> State:
        """The present state; valid until the next call."""
        ...

    @property
    def memory(self) -> dict[str, np.ndarray]:
        """What decides the future beyond ``state``, with a leading axis of the batch; most have nothing."""
        ...

    def recall(self, memory: dict[str, np.ndarray]) -> None:
        """Take back, after a ``reset`` of the whole batch, what ``memory`` held."""
        ...

    def reset(
        self,
        state: State,
        materials: Sequence[Material] | None = None,
        which: Sequence[int] | None = None,
    ) -> None:
        """Start from ``state`` (copied).

        With ``which`` only those members of the batch are replaced, and ``state`` holds just them.
        ``materials`` has one entry per member of ``state`` (default: the scene's).
        """
        ...

    def advance(self, controls: Controls) -> State:
        """One frame of ``scene.frame_dt`` for the whole batch."""
        ...


def make_backend(
    name: str, scene: Scene, *, num_envs: int = 1, backend_kwargs: Mapping[str, Any] | None = None
) -> Backend:
    """The backend ``name`` for a batch of ``num_envs`` cloths of ``scene``.

    Raises:
        ValueError: an unknown backend or keyword; the nearest match and the choices are named.
    """
    backend, given = registry.load_backend(name), backend_kwargs or {}
    check_keywords(backend, given, f"backend={name!r}")
    return backend(scene, num_envs=num_envs, **given)


def check_keywords(factory: Callable[..., Any], given: Mapping[str, Any], whose: str) -> None:
    """Refuse keywords that ``factory`` does not name; one that takes any (``**options``) checks them itself.

    Raises:
        ValueError: an unknown keyword; the nearest match and the choices are named.
    """
    parameters = signature(factory).parameters.values()
    known = [p.name for p in parameters if p.kind is p.KEYWORD_ONLY and p.name != "num_envs"]
    takes_any = any(p.kind is p.VAR_KEYWORD for p in parameters)
    for keyword in given:
        if keyword == "num_envs" or not (takes_any or keyword in known):
            raise unknown_name(f"keyword for {whose}:", keyword, known)
