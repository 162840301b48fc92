"""The protocol that every physics obeys, how one is built, and how one is written in a line."""

import json
from collections.abc import Callable, Mapping, Sequence
from inspect import Parameter, signature
from typing import Any, Protocol

import numpy as np

from cloth_envs.material import Material
from cloth_envs.naming import unknown_name
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State


class Backend(Protocol):
    """Physics for a batch of cloths of one scene.

    It owns its state: callers read ``state`` and copy what they keep; only ``time`` they may set. One that can't step
    every material has a method ``check_material(material)`` too, which raises ValueError and says what to change:
    environments ask it before anything is simulated. One that models ``Scene.self_contact`` has a true
    ``self_contact``; of any other the environment's scene lists none. Where another cloth moves than the one that
    ``state`` shows, failures are judged by what ``State.health`` says of it, and ``guarded`` ``(B,)`` tells the members
    that are drawn in a plainer way than usual, once they are read: environments pass that on as ``info["guard"]``.
    ``crossings`` ``(B,)`` may count the pairs of triangles that crossed as the last frame began, for
    ``info["crossings_at_start"]``. ``surrogate`` ``(B,)`` of text may say, after a reset, by what other means than
    usual a member is stepped, and why: ``info["surrogate"]`` of the reset. ``measured_error`` ``(B,)`` may tell, after
    a frame, how far each cloth was found to be from the reference [% of its length], NaN where it was not: ``info``
    has it.

    One with a ``torch.device`` as its ``device`` has tensors there in place of arrays: all fields of ``state``, which
    ``advance`` makes anew, and of ``controls``, in the same types; ``reset`` takes either. ``State.health`` is then a
    tensor ``(B, 3)`` float32 with 1 for finite.
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


def device_of(backend: Any) -> Any:
    """The ``torch.device`` on which a backend's arrays are tensors; None where they are NumPy's."""
    device = getattr(backend, "device", None)
    return device if hasattr(device, "type") else None


class Stateful:
    """The present state of a backend, as ``Backend`` has it, and no memory beyond it."""

    _state: State | None = None

    @property
    def state(self) -> State:
        """The present state of the whole batch. Raises RuntimeError: there is none before ``reset``."""
        if self._state is None:
            raise RuntimeError("there is no cloth yet: call reset(state) first")
        return self._state

    @property
    def memory(self) -> dict[str, np.ndarray]:
        """Empty: the state decides the future."""
        return {}

    def recall(self, memory: dict[str, np.ndarray]) -> None:
        """Nothing to take back. Raises ValueError: there is something, from another backend."""
        if memory:
            raise ValueError(f"{type(self).__name__} remembers nothing beyond its state, got {', '.join(memory)}")

    def _begin(self, state: State, which: Sequence[int] | None) -> None:
        """Make ``state`` the present one, or of the present one those members; callers pass a copy."""
        if which is None:
            self._state = state
        else:
            self._state = self.state.copy()
            self._state.assign(list(which), state)


def check_material(backend: Backend, material: Material) -> None:
    """Refuse what a backend says that it can't step. Raises ValueError: see ``Backend``."""
    check = getattr(backend, "check_material", None)
    if check is not None:
        check(material)


# What makes a backend: a class or function ``(scene, *, num_envs, **options)``, whose other options have defaults.
BackendFactory = Callable[..., Backend]


def keywords(factory: Callable[..., Any]) -> list[str]:
    """The options that ``factory`` names, without the scene and ``num_envs``."""
    parameters = list(signature(factory).parameters.values())[1:]
    named = (Parameter.KEYWORD_ONLY, Parameter.POSITIONAL_OR_KEYWORD)
    return [p.name for p in parameters if p.kind in named and p.name != "num_envs"]


def check_keywords(factory: Callable[..., Any], given: Mapping[str, Any], whose: str) -> None:
    """Refuse keywords that ``factory`` does not name; one that takes any (``**options``) checks them itself.

    Raises:
        ValueError: an unknown keyword; the nearest match and the choices are named.
    """
    if not isinstance(given, Mapping):
        raise ValueError(f"keywords for {whose} must be a dict, got {given!r}")
    known = keywords(factory)
    takes_any = any(p.kind is Parameter.VAR_KEYWORD for p in signature(factory).parameters.values())
    for keyword in given:
        if keyword == "num_envs" or not (takes_any or keyword in known):
            raise unknown_name(f"keyword for {whose}:", keyword, known)


def plain_words(options: Mapping[str, Any]) -> dict[str, Any]:
    """``options`` with ``physics`` and ``physics_kwargs`` as ``backend`` and ``backend_kwargs``, which they stand for.

    TorchRL's ``GymEnv`` keeps the word ``backend`` to itself, so there are others.

    Raises:
        ValueError: both words for one thing, with different values.
    """
    plain = dict(options)
    for name, word in (("backend", "physics"), ("backend_kwargs", "physics_kwargs")):
        value = plain.pop(word, None)
        if value is not None:
            if plain.get(name) and plain[name] != value:
                raise ValueError(f"{word}= is another word for {name}=: give one of {plain[name]!r} and {value!r}")
            plain[name] = value
    return plain


def read_object(text: str, what: str, example: str = '{"refine": 2}') -> dict[str, Any]:
    """A JSON object, such as the ``example``. Raises ValueError: not JSON, or not an object."""
    try:
        value = json.loads(text)
    except json.JSONDecodeError as error:
        raise ValueError(f"{what} must be JSON such as '{example}', got {text!r} ({error})") from error
    if not isinstance(value, dict):
        raise ValueError(f"{what} must be a JSON object such as '{example}', got {text!r}")
    return value


def parse_backend(text: str) -> tuple[str, dict[str, Any]]:
    """Name and options of ``NAME[=JSON]``, such as ``miniature={"factor": 4}`` or ``my_package.physics:MyBackend``.

    Raises:
        ValueError: options that are no JSON object, or a resolution as ``minicloth compare`` takes it.
    """
    name, _, options = text.partition("=")
    head, at, shape = name.partition("@")
    if at:
        raise ValueError(
            f"a resolution behind @ belongs to minicloth compare, got {name!r}: write --backend {head}, and where the "
            f"command has it --resolution {shape or 'ROWSxCOLS'}"
        )
    return name.strip(), read_object(options, f"what follows {name}=") if options else {}
