"""Who acts: open-loop actions, and a simple controller for every scene.

Controllers go from the default observation, single or batched, to the action, to be clipped to [-1, 1]. The task's
numbers are the last ones, after positions and velocities of the keypoints. ``examples/evaluate_controllers.py`` shows
what they earn.
"""

from functools import partial

import numpy as np

from cloth_envs.naming import REVISED, unknown_name

POLICIES = {
    "zero": "no action",
    "random": "uniform, new at every frame",
    "smooth": "slow random waves",
    "bang-bang": "full action one way or the other, for 5-20 frames",
    "alternating": "full action, turned at every frame",
}

BELL = np.linalg.pinv(np.vander(np.linspace(-0.5, 0.5, 4), 3)).T  # fits parabolas across four columns of keypoints


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
    if policy == "alternating":
        return np.where(np.arange(frames) % 2, -1.0, 1.0)[:, None] * np.ones(size)
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


def curtain(obs: np.ndarray) -> np.ndarray:
    """Pull the lead ring to the target; move the rail against the curtain's velocity, which damps a pendulum."""
    rail, covered, target = obs[..., -5], obs[..., -2], obs[..., -1]
    sway = obs[..., 60 + 28 : 60 + 40].mean(-1)  # y velocity of the lower three keypoint rows
    return np.stack([3 * (target - covered), -5 * (0.15 * sway + rail)], -1)


def flag(obs: np.ndarray) -> np.ndarray:
    """Sweep to and fro across the line of sight; turn round near the edge or when going nowhere."""
    pole, velocity, onlooker = obs[..., -8:-6], obs[..., -6:-4], obs[..., -2:]
    across = np.stack([-onlooker[..., 1], onlooker[..., 0]], -1)
    reach = 1.2 / np.abs(across).max(-1)
    place, speed = (pole * across).sum(-1), (velocity * across).sum(-1)
    way = np.where(np.abs(place) > reach, -np.sign(place), np.where(speed < 0, -1.0, 1.0))
    return across * way[..., None] / np.abs(across).max(-1, keepdims=True)


def collision(obs: np.ndarray) -> np.ndarray:
    """Move the ball to the goal."""
    return 3 * (obs[..., -3:] - obs[..., -9:-6])


def pressure(obs: np.ndarray, share: float = 1.0) -> np.ndarray:
    """The pressure that holds the height wanted in 0.05 s (it grows as the cube), and damping.

    ``share`` is 40 Pa over what the pump gives at full action.
    """
    _, velocity, _, target, soon = np.moveaxis(obs[..., -5:], -1, 0)
    wanted_velocity = (soon - target) / 0.1
    static = share * (0.05 + 560 * (0.5 * (target + soon)) ** 3)
    return (static + 0.03 * (wanted_velocity - velocity))[..., None]


def hanging(obs: np.ndarray) -> np.ndarray:
    """Bring the corner above the goal, leaning against the swing of the middle, which damps it."""
    corner, middle, velocity, goal = obs[..., -16:-13], obs[..., -10:-7], obs[..., -7:-4], obs[..., -4:-1]
    error = goal - 0.2 * velocity - corner
    error[..., 2] = (goal - middle)[..., 2]
    return 2 * error


def ball_drop(obs: np.ndarray) -> np.ndarray:
    """Run below the middle of the cloth while it falls, then stand still."""
    ball, middle, velocity = obs[..., -10:-8], obs[..., -6:-3], obs[..., -3:-1]
    falling = (middle[..., 2:] > 0.65) * 1.0
    return falling * (8 * (middle[..., :2] - ball) + velocity / 1.5)


def draping(obs: np.ndarray) -> np.ndarray:
    """As ``hanging``: the held point above the goal, leaning against the swing of the middle."""
    held, middle, velocity, goal = obs[..., -15:-12], obs[..., -9:-6], obs[..., -6:-3], obs[..., -3:]
    error = goal - 0.2 * velocity - held
    error[..., 2] = (goal - middle)[..., 2]
    return 2 * error


def hitting(obs: np.ndarray) -> np.ndarray:
    """Move the ball to before the target, and on by what the vertex misses of it."""
    ball, vertex, target = obs[..., -15:-12], obs[..., -9:-6], obs[..., -3:]
    wanted = target + 0.5 * (target - vertex)
    wanted[..., 1] -= 0.15 * np.sign(target[..., 1])
    return 3 * (wanted - ball)


def skirt(obs: np.ndarray) -> np.ndarray:
    """Turn the faster the wider the hem should be, and faster still while it is not; stay at the dance's height."""
    hem, target = obs[..., -2], obs[..., -1]
    turning = 24 * (target - 0.205) + 10 * (target - hem)
    return np.stack([turning, -5 * obs[..., -4]], -1)


def collision_shape(obs: np.ndarray) -> np.ndarray:
    """Of version 1: read off the wanted shape, a bell across, where a ball makes it, and move the ball there."""
    y, short, ball = obs[..., 24:40], obs[..., -22:-6], obs[..., -6:-3]
    curve, slope, level = np.moveaxis(np.log((y + short).reshape(*obs.shape[:-1], 4, 4)) @ BELL, -1, 0)
    aside = -0.5 * slope / curve  # of the bell, in each row
    peak = np.exp(level + 0.5 * slope * aside)
    depth = (0.375 * peak[..., 3] / peak[..., 0] - 0.24) / 0.84  # rows lie 0.375 m apart
    return 3 * (np.stack([aside.mean(-1), peak[..., 0] * depth / 0.375 - 0.2, -depth], -1) - ball)


def ball_drop_and_carry(obs: np.ndarray) -> np.ndarray:
    """Of version 1: as ``ball_drop``, then carry the cloth to the goal, gently."""
    falling, left = obs[..., -4:-3] > 0.65, 2 * obs[..., -12:-10]
    gently = left / np.maximum(np.linalg.norm(left, axis=-1, keepdims=True) / 0.5, 1)
    return np.where(falling, ball_drop(obs), gently)


CONTROLLERS = {
    "Curtain": curtain,
    "Flag": flag,
    "Collision": collision,
    "Pressure": pressure,
    "Hanging": hanging,
    "BallDrop": ball_drop,
    "Draping": draping,
    "Hitting": hitting,
    "Skirt": skirt,
}
CONTROLLERS |= {name + REVISED: controller for name, controller in CONTROLLERS.items()} | {
    "Collision-v1": collision_shape,
    "Pressure-v1": partial(pressure, share=0.5),
    "BallDrop-v1": ball_drop_and_carry,
}
