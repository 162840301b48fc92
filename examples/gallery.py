"""The picture of the README: a moment of every scene under its controller.

Run ``python examples/gallery.py``; writes docs/images/gallery.png.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import gymnasium as gym
import numpy as np
from PIL import Image

import cloth_envs
from cloth_envs.policies import CONTROLLERS

OUT = Path(__file__).parents[1] / "docs" / "images" / "gallery.png"
# Seed, frames, whether the controller acts.
MOMENTS = {
    "Curtain": (3, 45, True),
    "Flag": (1, 60, False),
    "Collision": (1, 120, True),
    "Pressure": (1, 82, True),
    "Hanging": (5, 30, True),
    "BallDrop": (2, 60, True),
    "Draping": (3, 16, False),
    "Hitting": (2, 12, True),
    "Skirt": (2, 380, True),
}


def picture(scene: str, seed: int, frames: int, active: bool) -> np.ndarray:
    """The scene after some frames, uint8 ``(480, 640, 3)``."""
    env = gym.make(cloth_envs.env_id(scene), render_mode="rgb_array")
    obs, _ = env.reset(seed=seed)
    env.render()  # places the camera
    for _ in range(frames):
        action = CONTROLLERS[scene](obs) if active else np.zeros(env.action_space.shape or ())
        obs, *_ = env.step(np.clip(action, -1, 1).astype(np.float32))
    image = env.render()
    env.close()
    return np.asarray(image)


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=OUT)
    parser.add_argument("--starts", action="store_true", help="draw the starts only")
    given = parser.parse_args(argv)
    out = given.out
    moments = {scene: (seed, 0 if given.starts else frames, on) for scene, (seed, frames, on) in MOMENTS.items()}
    tiles = [picture(scene, *moment) for scene, moment in moments.items()]
    sheet = Image.fromarray(np.concatenate([np.concatenate(tiles[i : i + 3], 1) for i in (0, 3, 6)], 0))
    out.parent.mkdir(parents=True, exist_ok=True)
    sheet.resize((1200, 900), Image.Resampling.LANCZOS).save(out, optimize=True)


if __name__ == "__main__":
    main()
