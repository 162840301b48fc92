"""What ``get_state`` saves, and the checks that a saved state passes before anything of an environment changes."""

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from cloth_envs.material import PROPERTIES, Material
from cloth_envs.naming import unknown_name
from cloth_envs.scene import Scene
from cloth_envs.state import State

LIMIT = 1e6  # m, m/s, Pa: numbers of a state or a task beyond it are no cloth's
OWN = "backend."  # before the names of what a backend remembers
ALIKE = ("action", "frames", "last_second")  # of a snapshot, an array with a row a member each
# Of a member: what names of what its backend remembers begin with, and which row of that is its own.
Place = Callable[[int], tuple[str, int]]


@dataclass
class Snapshot:
    """Everything that decides the future of a batch of B cloths.

    Attributes:
        scene, task: where it belongs. physics: the backend and its options in a line.
        state: the batch's. memory: of the task, ``(B, ...)`` each. own: of the backend, the same.
        action: the last one, ``(B, A)`` in [-1, 1]; 0 before the first. frames: of every episode, ``(B,)``.
        materials: one a member. rngs: one a member, None where none is known.
        last_second: rewards of the frames of the last second, ``(B, N)``, newest last.
    """

    scene: Scene
    task: type
    physics: str
    state: State
    memory: dict[str, np.ndarray]
    own: dict[str, np.ndarray]
    action: np.ndarray
    frames: np.ndarray
    materials: list[Material]
    rngs: list[np.random.Generator | None]
    last_second: np.ndarray

    def arrays(self) -> dict[str, np.ndarray]:
        """Copies by name, as ``other`` takes them back."""
        named = {f"state.{name}": value for name, value in self.state.arrays().items()}
        named |= {f"memory.{name}": value for name, value in self.memory.items()}
        named |= {f"{OWN}{name}": value for name, value in self.own.items()}
        named |= {"action": self.action, "frames": self.frames, "last_second": self.last_second}
        saved = {name: value.copy() for name, value in named.items()}
        saved["materials"] = np.array([[getattr(m, p) for p in PROPERTIES] for m in self.materials])
        texts = [json.dumps(rng and rng.bit_generator.state, default=np.ndarray.tolist) for rng in self.rngs]
        return saved | {"rng": np.array(texts), "scene": np.array(self._identity()), "backend": np.array(self.physics)}

    def other(self, saved: Mapping[str, Any]) -> "Snapshot":
        """What ``arrays`` of another moment gave, checked; what another backend remembered is left out.

        Raises:
            ValueError: something is missing, unknown, of another shape, not finite, or of another scene; or time is
                not frames times the frame.
        """
        if not isinstance(saved, Mapping):
            raise ValueError(f"a state is the dict that get_state() gave, got {type(saved).__name__}")
        try:
            parts = dict(saved)
        except Exception as error:  # of a damaged file, which NumPy reads only now
            raise ValueError(f"this state can't be read ({error}): pass what get_state() gave") from error
        check_scene(parts.pop("scene", None), self._identity())
        physics = str(parts.pop("backend", None))
        needed = self._shapes()
        lacks = [name for name in needed if name not in parts]
        if lacks:
            raise ValueError(f"this state lacks {', '.join(lacks)}: pass all that get_state() gave")
        for name in parts:
            if name not in needed and not str(name).startswith(OWN):
                raise unknown_name("part of a state:", name, needed)
        own = {OWN + name: value.shape for name, value in self.own.items()}
        remembered = {n: shape for n, shape in own.items() if n in parts and np.shape(parts[n]) == shape}
        if remembered.keys() != own.keys():
            if physics == self.physics:
                raise ValueError(f"this state lacks {', '.join(own)} of its backend, or they have other shapes")
            remembered = {}
        texts = np.asarray(parts["rng"])
        if texts.shape != needed["rng"] or texts.dtype.kind != "U":
            raise ValueError(f"rng must be texts of shape {needed['rng']}, got {texts.dtype} of shape {texts.shape}")
        kinds = {"frames": "iu"} | {f"memory.{name}": value.dtype.kind for name, value in self.memory.items()}
        numbers = {n: shape for n, shape in needed.items() if n != "rng"} | remembered
        values = {n: check_array(n, parts[n], shape, kinds.get(n, "f")) for n, shape in numbers.items()}
        values["state.time"] = self._check_time(values["frames"], values["state.time"])
        return replace(
            self,
            state=State(**_under("state.", values)),
            memory=_under("memory.", values),
            own=_under(OWN, values),
            action=values["action"].astype(np.float64).clip(-1.0, 1.0),
            frames=values["frames"].astype(np.int64),
            materials=[Material(**dict(zip(PROPERTIES, row, strict=True))) for row in values["materials"].tolist()],
            last_second=values["last_second"],
            rngs=[_generator(text) or old for text, old in zip(texts.tolist(), self.rngs, strict=True)],
        )

    def alone(self, i: int, place: Place) -> "Snapshot":
        """That of member ``i`` as of a single environment."""
        start, row = place(i)
        own = {name.removeprefix(start): value for name, value in self.own.items() if name.startswith(start)}
        return replace(
            self,
            state=self.state.select([i]),
            memory={name: value[[i]] for name, value in self.memory.items()},
            own={name: value[[row]] for name, value in own.items()},
            materials=[self.materials[i]],
            rngs=[self.rngs[i]],
            **{name: getattr(self, name)[[i]] for name in ALIKE},
        )

    def put(self, others: Mapping[int, "Snapshot"], place: Place) -> "Snapshot":
        """A copy with ``others``, as ``alone`` gives them, as members by number."""
        new = replace(
            self,
            state=self.state.select(slice(None)),
            memory={name: value.copy() for name, value in self.memory.items()},
            own={name: value.copy() for name, value in self.own.items()},
            materials=list(self.materials),
            rngs=list(self.rngs),
            **{name: getattr(self, name).copy() for name in ALIKE},
        )
        for i, other in others.items():
            new.state.assign([i], other.state)
            new.recall(i, other.own, place)
            for name, value in other.memory.items():
                new.memory[name][i] = value[0]
            for name in ALIKE:
                getattr(new, name)[i] = getattr(other, name)[0]
            new.materials[i], new.rngs[i] = other.materials[0], other.rngs[0]
        return new

    def recall(self, i: int, own: Mapping[str, np.ndarray], place: Place) -> None:
        """Let the backend have remembered ``own``, ``(1, ...)`` each, of member ``i``."""
        start, row = place(i)
        for name, value in own.items():
            self.own[start + name][row] = value[0]

    def _identity(self) -> str:
        """What must be equal where a state is taken back, whatever the material; JSON."""
        others = ("material", "handles", "grips", "name", "driven_by")
        parts = {n: value for n, value in asdict(self.scene).items() if n not in others}
        return json.dumps({"scene": self.scene.name, "task": self.task.__name__, **parts})

    def _shapes(self) -> dict[str, tuple[int, ...]]:
        """Of everything that a state must hold, by name; what a backend remembers comes beside it."""
        batch, cloth, bodies = len(self.frames), (3, *self.scene.grid.shape), (len(self.scene.colliders), 2, 3)
        state: dict[str, tuple[int, ...]] = {"positions": cloth, "velocities": cloth}
        state |= {"wind": (3,), "pressure": (), "time": (), "colliders": bodies, "collider_velocities": bodies}
        found = {f"state.{name}": (batch, *shape) for name, shape in state.items()}
        found |= {f"memory.{name}": value.shape for name, value in self.memory.items()}
        found |= {"frames": (batch,), "materials": (batch, len(PROPERTIES)), "rng": (batch,)}
        return found | {"action": self.action.shape, "last_second": self.last_second.shape}

    def _check_time(self, frames: np.ndarray, time: np.ndarray) -> np.ndarray:
        """Frames times the frame. Raises ValueError: ``time`` is another one, or frames are negative."""
        exact: np.ndarray = frames * self.scene.frame_dt
        if (frames < 0).any() or (abs(time - exact) > self.scene.frame_dt / 2).any():
            raise ValueError(
                f"state.time must be frames times {self.scene.frame_dt:g} s, and frames at least 0, got times of "
                f"{time[:3].tolist()} for frames of {frames[:3].tolist()}"
            )
        return exact


def check_array(name: str, value: Any, shape: tuple[int, ...], kinds: str = "f") -> np.ndarray:
    """A copy of finite numbers of ``shape``, of one of NumPy's ``kinds``; a state's and a task's are within ``LIMIT``.

    Raises:
        ValueError: they are not.
    """
    if isinstance(value, np.ma.MaskedArray):
        raise ValueError(f"{name} is a masked array: pass a plain one")
    try:
        given = np.array(value)
    except Exception as error:  # whatever an object's own __array__ raises
        raise ValueError(f"{name} must be an array of shape {shape} ({error})") from error
    if given.shape != shape:
        raise ValueError(f"{name} must have shape {shape}, got {given.shape}")
    if given.dtype.kind not in kinds or given.dtype == np.float16:
        wanted = {"iu": "whole numbers", "b": "bool"}.get(kinds, "float32 or float64")
        raise ValueError(f"{name} must be {wanted}, got {given.dtype}")
    if not np.isfinite(given).all():
        raise ValueError(f"{name} must be finite, it holds NaN or infinity")
    limited = name.startswith(("state.", "memory.", OWN)) and name != "state.time"
    if limited and (abs(given) > LIMIT).any():
        raise ValueError(f"{name} must lie within +-{LIMIT:g}, got {abs(given).max():g}: SI units")
    return given


def check_scene(found: Any, wanted: str) -> None:
    """Refuse a state whose ``identity`` is another. Raises ValueError: says in what they differ."""
    if found is None:
        raise ValueError("this state lacks scene: pass all that get_state() gave")
    try:
        there, here = json.loads(str(found)), json.loads(wanted)
        other = [f"{n} {there.get(n)!r} instead of {value!r}" for n, value in here.items() if there.get(n) != value]
    except (ValueError, AttributeError, RecursionError) as error:
        raise ValueError(f"this state's scene can't be read ({error}): pass what get_state() gave") from error
    if other:
        raise ValueError(
            f"this state is of another scene, preset, resolution or self_contact ({'; '.join(other[:2])}): "
            "set it in an environment made with the same arguments"
        )


def _under(prefix: str, values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name[len(prefix) :]: value for name, value in values.items() if name.startswith(prefix)}


def _generator(text: str) -> np.random.Generator | None:
    """The generator that a JSON text tells, None of ``null``. Raises ValueError: it tells none, or a broken one."""
    try:
        content = json.loads(text)
        if content is None:
            return None
        generator = np.random.Generator(getattr(np.random, content["bit_generator"])())
        generator.bit_generator.state = content
        as_taken = json.dumps(generator.bit_generator.state, default=np.ndarray.tolist)
        increment = dict(content["state"]).get("inc", 1)  # of PCG64, where it is odd
        if as_taken != json.dumps(content) or content.get("has_uint32", 0) not in (0, 1) or increment % 2 == 0:
            raise ValueError("its numbers can't be those of a generator")
    except Exception as error:  # generators of NumPy refuse in many ways
        raise ValueError(f"this state's rng can't be read ({error}): pass what get_state() gave") from error
    return generator
