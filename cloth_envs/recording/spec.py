"""What a file says of the environment that it was recorded from, as texts."""

import json
from dataclasses import replace
from typing import Any

import gymnasium as gym

from cloth_envs.recording.layout import plain


def spec_texts(env: gym.Env[Any, Any]) -> dict[str, str]:
    """The attributes ``env_spec``, ``env_spec_left_out`` and ``wrappers``.

    The spec is that of the unwrapped environment, whose actions and rewards are recorded; wrappers are named only.
    Arguments that JSON can't hold are left out of it, and named too.
    """
    spec, layer = env.unwrapped.spec, env
    wrappers, left_out = [], []
    while isinstance(layer, gym.Wrapper):
        wrappers.append(type(layer).__name__)
        layer = layer.env
    text = ""
    if spec is not None:
        kept = {}
        for name, value in spec.kwargs.items():
            try:
                kept[name] = json.loads(json.dumps(value, default=plain))
            except (TypeError, ValueError):
                left_out.append(name)
        if callable(spec.entry_point):
            left_out.append("entry_point")
        else:
            text = replace(spec, kwargs=kept, additional_wrappers=()).to_json()
    return {"env_spec": text, "env_spec_left_out": ", ".join(left_out), "wrappers": ", ".join(wrappers)}
