"""Make an environment, step it, record it, draw it: ``python examples/quickstart.py [folder]``."""

import sys
from pathlib import Path

import gymnasium as gym
import imageio.v2 as imageio

import cloth_envs  # noqa: F401  (registers the environments)
from cloth_envs.recording import RecordRollout, Rollout

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
env = gym.make("MiniCloth-Flag-v0", render_mode="rgb_array", material="silk")
print(env.unwrapped.scene.describe())

env = RecordRollout(env, str(folder / "flag.h5"), overwrite=True)
observation, info = env.reset(seed=7)
env.action_space.seed(7)
total = 0.0
for _ in range(50):
    observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
    total += reward
    if terminated or truncated:
        break
imageio.imwrite(folder / "flag.png", env.render())
env.close()
print(f"{total / 50:.2f} of the flag shown on average; wrote {folder / 'flag.png'} and {folder / 'flag.h5'}")

with Rollout.open(folder / "flag.h5") as rollout:
    fastest = max(float(abs(state.velocities).max()) for state in rollout.states())
    print(f"{rollout.lengths[0]} frames recorded, fastest vertex component {fastest:.1f} m/s")
