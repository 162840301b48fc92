"""Keywords that no environment takes: what was meant, and where it is written."""

from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

from cloth_envs.backend import keywords
from cloth_envs.naming import resolve, unknown_name
from cloth_envs.physics.solver import SOLVERS
from cloth_envs.registry import BACKENDS, load_backend

# What other packages call it.
MEANT = {
    "fabric": "material",
    "cloth": "material",
    "domain_randomization": "randomize",
    "grid": "resolution",
    "size": "resolution",
    "observation": "obs",
    "obs_type": "obs",
    "simulator": "backend",
    "render": "render_mode",
    "kwargs": "backend_kwargs",
}
# What is no keyword of an environment: where it belongs.
ELSEWHERE = {
    "seed": "a seed is given to the reset: write env.reset(seed={value!r})",
    "options": "options are given to the reset: write env.reset(options={value!r})",
    "num_envs": "a single environment has one cloth: write gymnasium.make_vec(id, num_envs={value!r})",
    "n_envs": "many cloths are num_envs of a vector environment: write gymnasium.make_vec(id, num_envs={value!r})",
}


def check_options(given: Mapping[str, Any], *takers: Callable[..., Any]) -> None:
    """Refuse the first keyword of ``given`` that none of ``takers`` names.

    Raises:
        ValueError: says where it belongs, or names the choices and the nearest match.
        TypeError: ``frameskip``, which TorchRL's ``GymEnv`` tries on every environment; it goes by these words.
    """
    choices = dict.fromkeys(name for taker in takers for name in keywords(taker))
    for name, value in given.items():
        if name in choices:
            continue
        if name == "frameskip":
            raise TypeError("got an unexpected keyword argument 'frameskip': repeat actions in a wrapper")
        if name in ELSEWHERE:
            raise ValueError(f"unknown keyword {name!r}; {ELSEWHERE[name].format(value=value)}")
        owner = _owner(name, given)
        if owner is not None:
            text = ", ".join(f"{key}={item!r}" for key, item in owner.items())
            raise ValueError(f"unknown keyword {name!r}; it belongs to the physics: write {text}")
        raise unknown_name("keyword", name, choices, meant=MEANT.get(name))


def _owner(name: str, given: Mapping[str, Any]) -> dict[str, Any] | None:
    """The options with which a backend or a solver takes the keyword, those given first; None if none does."""
    chosen, own = given.get("backend", "reference"), given.get("backend_kwargs")
    kwargs = {**(own if isinstance(own, Mapping) else {}), name: given[name]}
    names = [chosen, *BACKENDS] if isinstance(chosen, str) else list(BACKENDS)
    for backend in names:
        takes: list[str] = []
        with suppress(ValueError, ImportError):  # a backend of somebody else's that can't be loaded says so when chosen
            takes = keywords(load_backend(backend))
        if name in takes:
            return ({"backend": backend} if backend != "reference" else {}) | {"backend_kwargs": kwargs}
    for solver, path in SOLVERS.items():
        if name in keywords(resolve(path)):
            choice = {} if solver == "explicit" else {"solver": solver}
            return {"backend_kwargs": choice | kwargs}
    return None
