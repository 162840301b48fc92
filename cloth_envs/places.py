"""Where a keyword is written that was given in another place: which backend or solver takes it, and with what."""

import json
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from inspect import Parameter, signature
from typing import Any

from cloth_envs.arguments import as_items
from cloth_envs.backend import keywords
from cloth_envs.naming import resolve, unknown_name
from cloth_envs.physics.solver import SOLVERS, reference
from cloth_envs.registry import BACKENDS, load_backend

FRAME = "a frame's length belongs to the scene: leave it out; backend_kwargs={{'refine': 2}} steps twice as finely"
# What neither an environment nor a physics takes, and what to do instead.
ELSEWHERE = {
    "seed": "a seed is given to the reset: write env.reset(seed={value!r})",
    "options": "options are given to the reset: write env.reset(options={value!r})",
    "num_envs": "a single environment has one cloth: write gymnasium.make_vec(id, num_envs={value!r})",
    "n_envs": "many cloths are num_envs of a vector environment: write gymnasium.make_vec(id, num_envs={value!r})",
    "desync": "episodes of a batch end at different times: write gymnasium.make_vec(id, desync={value!r})",
    "friction": "friction is of a scene's bodies and layers (Collider, SelfContact of cloth_envs): leave it out",
    "frame_skip": "a wrapper repeats actions: leave it out",
    **dict.fromkeys(("frame_dt", "dt", "timestep", "time_step"), FRAME),
}

Options = Mapping[str, Any]


def as_arguments(backend: str, options: Options, chosen: object) -> str:
    """A physics as arguments of ``gymnasium.make``, in which ``chosen`` is the backend already, or a list of them."""
    if as_items(chosen) is not None:
        return f"a list as backend_kwargs, with {dict(options)!r} for each member of backend {backend!r}"
    return ("" if backend == chosen else f"backend={backend!r}, ") + f"backend_kwargs={dict(options)!r}"


def as_option(backend: str, options: Options) -> str:
    """A physics as an option of a command."""
    return f"--backend '{backend}={json.dumps(dict(options), default=str)}'"


def find_home(
    word: str, value: object, backend: object, given: Options, solvers: Mapping[str, str] = SOLVERS
) -> tuple[str, dict[str, Any]] | None:
    """The backend and its options with which ``word`` is taken, near to the chosen ones; None if nothing takes it.

    ``backend`` is what was chosen: a name, or a list of them.
    """
    chosen = [name for name in as_items(backend) or [backend] if isinstance(name, str)]
    for name in dict.fromkeys([*chosen, *BACKENDS]):
        with suppress(ValueError, ImportError):  # a backend of somebody else's that can't be loaded says so when chosen
            for options in _homes(word, value, keywords(load_backend(name)), given, solvers):
                return name, options
    return None


def _homes(
    word: str, value: object, takes: list[str], given: Options, solvers: Mapping[str, str]
) -> Iterator[dict[str, Any]]:
    """Options that hold ``word``, of a backend that names ``takes``; of ``given`` they keep what fits."""
    fits = {name: item for name, item in given.items() if name in takes and name not in (word, "solver_kwargs")}
    if "solver" not in takes:
        if word in takes:
            yield fits | {word: value}
        return
    usual = fits["solver"] if isinstance(fits.get("solver"), str) else "explicit"
    nested = "solver_kwargs" in takes
    for solver in dict.fromkeys([usual, *solvers]):
        own = keywords(resolve(solvers[solver])) if solver in solvers else []
        beside = given.get("solver_kwargs") if nested else given
        rest = {n: v for n, v in beside.items() if n in own and n != word} if isinstance(beside, Mapping) else {}
        if word in takes:
            yield fits | ({"solver_kwargs": rest} if nested and rest else rest) | {word: value}
        elif word in own:
            choice = {} if solver == usual else {"solver": solver}
            rest |= {word: value}
            yield fits | choice | ({"solver_kwargs": rest} if nested else rest)


def check_backend_kwargs(
    backend: str,
    given: object,
    *,
    solvers: Mapping[str, str] = SOLVERS,
    beside: Collection[str] = (),
    shell: bool = False,
) -> None:
    """Refuse the first keyword that ``backend``, or the solver that it is given, does not take.

    Args:
        backend: its name.
        given: what it is asked to be built with.
        solvers: those that step the scene, as ``SOLVERS``.
        beside: the keywords of an environment, which stand beside ``backend_kwargs``.
        shell: it was given to a command.

    Raises:
        ValueError: says where the keyword belongs, or names the choices and the nearest match.
        ImportError: the backend can't be loaded.
    """
    factory = load_backend(backend)
    if not isinstance(given, Mapping):
        return  # ``make_backend`` says so
    takes, whose = keywords(factory), f"backend={backend!r}"
    solver, nested = given.get("solver", "explicit"), given.get("solver_kwargs")
    own = keywords(resolve(solvers[solver])) if isinstance(solver, str) and solver in solvers else None
    parts: list[tuple[str, Options, list[str]]] = []
    if factory is reference:
        parts += [(f"{whose} with solver={solver!r}", given, [*takes, *own])] if own is not None else []
    elif not any(p.kind is Parameter.VAR_KEYWORD for p in signature(factory).parameters.values()):
        parts.append((whose, given, takes))
    if own is not None and "solver_kwargs" in takes and isinstance(nested, Mapping):
        parts.append((f"solver_kwargs of {whose} with solver={solver!r}", nested, own))
    for what, words, known in parts:
        for word, value in words.items():
            if word not in known:
                start, home = f"unknown keyword for {what}: {word!r}", find_home(word, value, backend, given, solvers)
                if word == "solver_kwargs" and factory is reference and isinstance(value, Mapping):
                    home = backend, {name: item for name, item in given.items() if name != word} | dict(value)
                if word in ELSEWHERE:
                    raise ValueError(f"{start}; {ELSEWHERE[word].format(value=value)}")
                if word in beside:
                    raise ValueError(
                        f"{start}; it belongs to the environment: write {word}={value!r} beside backend_kwargs"
                    )
                if home is not None:
                    raise ValueError(f"{start}; write {as_option(*home) if shell else as_arguments(*home, backend)}")
                raise unknown_name(f"keyword for {what}:", word, known)
