"""What every scene does under every physics, as hashes: ``python tests/fingerprint.py OUT.json [--against OLD.json]``.

Run it before and after a change that must not touch the physics, on one machine. Positions and velocities of every
frame are hashed, and must be the same; rewards and observations are kept, and must be the same to ``TOLERANCE``.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

import cloth_envs

TOLERANCE = 1e-6
SEEDS = 3  # 0, 1, 2: the members of a batch
POLICIES = ("smooth", "bang-bang")
LEE, ZHAO = ("Curtain", "Flag", "Collision"), ("Pressure", "Hanging", "BallDrop")
CORRECTED = {"Curtain": (4,)}
SLOW = 3  # frames of what takes seconds a frame


@dataclass(frozen=True)
class Case:
    """One environment: what ``gym.make`` is told, and for how many frames it is watched."""

    scene: str
    backend: str = "reference"
    kwargs: dict[str, Any] = field(default_factory=dict)
    preset: str | None = None
    frames: int = 100
    single: bool = False

    @property
    def name(self) -> str:
        """What tells it from all others."""
        parts = [self.scene, self.preset or "", self.backend, json.dumps(self.kwargs, sort_keys=True)]
        return " ".join([*filter(None, parts), "single" if self.single else "vector"])


def cases(frames: int) -> Iterator[Case]:
    """All of them."""
    for scene in (*LEE, *ZHAO):
        preset = "lee2019" if scene in LEE else "zhao2024"
        for dtype in ("float32", "float64"):
            for single in (False, True):
                yield Case(scene, kwargs={"dtype": dtype}, frames=frames, single=single)
            yield Case(scene, kwargs={"dtype": dtype, "solver": "admm"}, frames=frames)
            yield Case(scene, "cnn", {"dtype": dtype}, frames=frames)
            yield Case(scene, kwargs={"dtype": dtype}, preset=preset, frames=min(frames, 50))
            yield Case(scene, "cnn", {"dtype": dtype}, preset=preset if scene in ZHAO else None, frames=min(frames, 50))
        yield Case(
            scene, kwargs={"solver": "implicit", "tolerance": 1.0, "max_iterations": 40}, frames=SLOW, single=True
        )
        yield Case(
            scene, kwargs={"solver": "implicit", "scheme": "sdirk2", "max_iterations": 40}, frames=SLOW, single=True
        )
        yield Case(scene, kwargs={"solver": "admm", "iterations": 5, "substeps": 3}, frames=frames)
        yield Case(scene, "miniature", frames=frames)
        yield Case(scene, "miniature", frames=frames, single=True)
        for factor in (2, 3, 4):
            for scaling in ("similar", "seed", "calibrated", "closure"):
                options = {"factor": factor, "scaling": scaling}
                yield Case(scene, "miniature", {**options, "upscaler": "bicubic"}, frames=frames)
                yield Case(scene, "miniature", {**options, "upscaler": "local", "guard": True}, frames=frames)
            for upscaler in ("bilinear", "biquadratic", "ridge"):
                yield Case(scene, "miniature", {"factor": factor, "upscaler": upscaler}, frames=frames)
            if scene in LEE:
                yield Case(scene, "miniature", {"factor": factor, "upscaler": "fc"}, preset, frames)
                if factor != 3:
                    yield Case(scene, "miniature", {"factor": factor, "upscaler": "hdnn"}, preset, frames)
        for factor in CORRECTED.get(scene, ()):
            options = {"factor": factor, "scaling": "closure", "upscaler": "local", "correction": "learned"}
            yield Case(scene, "miniature", options, frames=frames)
        yield Case(scene, "miniature", {"solver": "admm"}, frames=frames)
    yield Case("Pressure", preset="zhao2024-fall", frames=min(frames, 50))


def watch(case: Case, policy: str) -> dict[str, Any]:
    """Hashes of all frames' positions and velocities, and every reward and observation."""
    options: dict[str, Any] = {"backend": case.backend, "backend_kwargs": case.kwargs, "preset": case.preset}
    name, cloth, batch = cloth_envs.env_id(case.scene), hashlib.sha256(), 1 if case.single else SEEDS
    if case.single:
        env: Any = gym.make(name, **options)
        observation, _ = env.reset(seed=0)
        world, size = env.unwrapped, env.action_space.shape[0]
    else:
        env = gym.make_vec(name, num_envs=SEEDS, **options)
        observation, _ = env.reset(seed=0)
        world, size = env, env.single_action_space.shape[0]
    moves = np.stack([actions(policy, case.frames, size, world.scene.frame_dt, seed) for seed in range(batch)], 1)
    seen, earned = [observation], []
    for action in moves:
        observation, reward, *_ = env.step(action[0] if case.single else action)
        cloth.update(np.ascontiguousarray(world.state.positions).tobytes())
        cloth.update(np.ascontiguousarray(world.state.velocities).tobytes())
        seen.append(observation)
        earned.append(reward)
    env.close()
    thin = np.array(seen, np.float64).reshape(len(seen), batch, -1)[::10]  # every tenth frame is enough of these
    return {"cloth": cloth.hexdigest(), "rewards": np.array(earned, float).tolist(), "seen": thin.tolist()}


def actions(policy: str, frames: int, size: int, frame_dt: float, seed: int) -> np.ndarray:
    """Actions ``(frames, size)``, kept apart from the package's own so that those may change."""
    rng = np.random.default_rng([seed, 0xF1])
    if policy == "smooth":
        time, rate = np.arange(frames)[:, None] * frame_dt, 2 * np.pi * rng.uniform(0.1, 0.7, size)
        return np.sin(rate * time + rng.uniform(0, 2 * np.pi, size)) * 0.8
    return np.repeat(rng.choice([-1.0, 1.0], (frames // 8 + 1, size)), 8, axis=0)[:frames]


def differences(before: dict[str, Any], after: dict[str, Any]) -> list[str]:
    """What is not the same, a line a case."""
    found = [f"{name}: only in one of the two" for name in sorted(before.keys() ^ after.keys())]
    for name in before.keys() & after.keys():
        one, two = before[name], after[name]
        if one["cloth"] != two["cloth"]:
            found.append(f"{name}: positions or velocities differ")
        for part in ("rewards", "seen"):
            gap = np.abs(np.array(one[part]) - np.array(two[part])).max()
            if not gap <= TOLERANCE:
                found.append(f"{name}: {part} differ by {gap:.1e}")
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--against", type=Path, help="what an earlier run wrote")
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--only", default="", help="cases whose name holds this")
    given = parser.parse_args()
    found: dict[str, Any] = {}
    for case in {case.name: case for case in cases(given.frames)}.values():
        if given.only in case.name:
            for policy in POLICIES:
                found[f"{case.name} {policy}"] = watch(case, policy)
            print(case.name, found[f"{case.name} smooth"]["cloth"][:16], flush=True)
    given.out.write_text(json.dumps(found))
    if given.against:
        before = json.loads(given.against.read_text())
        gone = differences({name: before[name] for name in before if given.only in name}, found)
        print("\n".join(gone) if gone else f"{len(found)} cases are as they were")
        return bool(gone)
    return 0


if __name__ == "__main__":
    sys.exit(main())
