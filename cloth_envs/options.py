"""Keywords that no environment takes: what was meant, and where it is written."""

from collections.abc import Callable, Mapping
from typing import Any

from cloth_envs import material
from cloth_envs.backend import keywords
from cloth_envs.naming import unknown_name
from cloth_envs.places import ELSEWHERE, as_arguments, find_home
from cloth_envs.presets import preset_with

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


def check_options(given: Mapping[str, Any], scene: object, *takers: Callable[..., Any]) -> None:
    """Refuse the first keyword of ``given``, for an environment of ``scene``, that none of ``takers`` names.

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
        own, chosen = given.get("backend_kwargs"), given.get("backend", "reference")
        home = find_home(name, value, chosen, own if isinstance(own, Mapping) else {})
        if home is not None:
            raise ValueError(
                f"unknown keyword {name!r}; it belongs to the physics: write {as_arguments(*home, chosen)}"
            )
        preset = given.get("preset")
        whole = preset_with(scene, preset, name, value)
        of_material = name in material.PROPERTIES or name in material.MEANT
        if whole is not None and not (of_material and preset is None):
            raise ValueError(f"unknown keyword {name!r}; it belongs to the preset: write preset={whole!r}")
        if of_material:
            write = {material.MEANT.get(name, name): value}
            raise ValueError(f"unknown keyword {name!r}; it belongs to the material: write material={write!r}")
        raise unknown_name("keyword", name, choices, meant=MEANT.get(name))
