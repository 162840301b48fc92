"""Open-loop actions for rollouts and comparisons."""

from __future__ import annotations

import numpy as np

from cloth_envs.naming import unknown_name

POLICIES = {
    "zero": "no action",
    "random": "uniform, new at every frame",
    "smooth": "slow random waves",
    "bang-bang": "full action one way or the other, for 5-20 frames",
}


def open_loop(policy: str, frames: int, size: int, frame_dt: float, seed: int) -> np.ndarray:
    """Actions ``(frames, size)`` in [-1, 1]; equal arguments give equal actions.

    Raises:
        ValueError: an unknown policy; the nearest match is named.
    """
    if policy not in POLICIES:
        raise unknown_name("policy", policy, POLICIES)
    rng = np.random.default_rng([seed, 0xAC7])
    if policy == "random":
        return rng.uniform(-1, 1, (frames, size))
    actions = np.zeros((frames, size))
    if policy == "smooth":
        time = np.arange(frames)[:, None] * frame_dt
        rates = 2 * np.pi * rng.uniform(0.1, 0.7, (3, size))  # rad/s
        actions = np.sin(rates[:, None] * time + rng.uniform(0, 2 * np.pi, (3, 1, size))).mean(0)
    elif policy == "bang-bang":
        for column in actions.T:
            start = 0
            while start < frames:
                end = start + int(rng.integers(5, 21))
                column[start:end] = rng.choice([-1.0, 1.0])
                start = end
    return actions
