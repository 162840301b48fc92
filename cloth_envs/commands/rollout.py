"""``minicloth rollout`` and ``minicloth render``: simulate once, look at it as often as you like."""

from contextlib import ExitStack
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from cloth_envs.agents import FILES, LEARNED, load_policy
from cloth_envs.commands.outputs import Goal, check_pictures, planned, write_pictures
from cloth_envs.files import check_file
from cloth_envs.naming import counted, unknown_name
from cloth_envs.policies import POLICIES, open_loop
from cloth_envs.progress import announce, progress
from cloth_envs.recording import RecordRollout, Rollout
from cloth_envs.registry import EPISODE_FRAMES, env_id, load_task

SEEING = ("controller", LEARNED)  # policies by name that act on what they observe


def rollout(
    scene: str,
    *,
    frames: int | None,
    seed: int,
    policy: str,
    video: str | None,
    images: str | None,
    hdf5: str | None,
    strain: bool,
    overwrite: bool,
    goal: bool = True,
    caption: bool = False,
    **options: Any,
) -> str:
    """One episode of the environment with these ``options``; returns what happened as text.

    Pictures show the ``goal``, and with a ``caption`` under them what is earned.

    Raises:
        ValueError, OSError, ImportError: a bad name or number, an output that can't be written, a package
            that is missing; nothing has been simulated by then.
    """
    task = load_task(scene)
    frames = EPISODE_FRAMES[scene] if frames is None else frames
    named = (*POLICIES, *SEEING)
    if policy not in named and ":" not in policy and Path(policy).suffix not in FILES:
        raise unknown_name("policy (or module:function, .zip, .pt, .safetensors):", policy, named)
    seeing = None if policy in POLICIES else load_policy(policy, scene)
    planned_actions = open_loop("zero" if seeing else policy, frames, len(task.actions), task.frame_dt, seed)
    check_pictures(video, images)
    if hdf5 is not None and Path(hdf5).exists() and not overwrite:
        raise FileExistsError(f"{hdf5} exists and stays as it is: choose another name or add --overwrite")
    if hdf5 is not None:
        check_file(hdf5)
    outputs = ", ".join(planned(path) for path in (hdf5, video, images) if path is not None)
    with ExitStack() as stack:
        env: gym.Env[Any, Any] = gym.make(env_id(scene), max_episode_steps=frames, disable_env_checker=True, **options)
        stack.callback(env.close)
        cloth: Any = env.unwrapped
        drawn = video is not None or images is not None
        if hdf5 is not None:
            env = RecordRollout(env, hdf5, overwrite=overwrite)
            stack.callback(env.close)
        rows, cols = cloth.scene.grid.shape
        announce(
            f"{scene}: {counted(frames, 'frame')} of {task.frame_dt * 1e3:g} ms, {rows} x {cols} vertices, "
            + (f"then {frames + 1} pictures; " if drawn else "")
            + (f"into {outputs}" if outputs else "nothing is written (see --video, --images, --hdf5)")
        )
        seen, _ = env.reset(seed=seed)
        states, goals = [cloth.state.copy()], []
        if drawn:
            goals.append(_goal(cloth, goal, {} if caption else None))
        total, failure, info = 0.0, None, dict[str, Any]()
        for action in progress(planned_actions.astype("f4"), scene, frames, unit="frame"):
            chosen = np.clip(seeing(seen[None])[0], -1, 1).astype("f4") if seeing else action
            seen, reward, terminated, _, info = env.step(chosen)
            total += float(reward)
            if drawn:
                states.append(cloth.state.copy())
                goals.append(_goal(cloth, goal, info | {"reward": reward} if caption else None))
            if terminated:
                failure = info["failure"]
                break
        seconds = cloth.time
    write_pictures(cloth.scene, states, video=video, images=images, strain=strain, goals=goals)
    ended = f"failed ({failure})" if failure else "ended"
    met = f", {'a' if info['success'] else 'no'} success at the end" if "success" in info else ""
    lines = [f"{scene} {ended} after {seconds:.2f} s, mean reward {total / frames:.3f}{met}"]
    lines += [f"wrote {path}" for path in (hdf5, video, images) if path is not None]
    return "\n".join(lines)


def _goal(cloth: Any, shown: bool, info: dict[str, Any] | None) -> Goal:
    """What a picture of the environment shows now; ``info``, with its reward, is told in words, if there is any."""
    marks, met = cloth.world.goal(0) if shown else ((), False)
    if info is None:
        return Goal(marks, met)
    parts = ", ".join(f"{name[7:]} {info[name]:.2f}" for name in info if name.startswith("reward_"))
    told = f"reward {info['reward']:.2f}{'   success' if info.get('success') else ''}\n{parts}" if info else "start\n"
    return Goal(marks, met, told)


def render(file: str, *, trajectory: int, video: str | None, images: str | None, strain: bool) -> str:
    """Draw one trajectory of a rollout file; without any output, to a video beside it.

    Raises:
        ValueError, OSError, ImportError: see ``Rollout.open`` and ``check_pictures``.
    """
    with Rollout.open(file) as record:
        scene, states = record.scene, list(record.states(trajectory))
    if not states:
        raise ValueError(
            f"trajectory {trajectory} of {file} holds no whole frame: its writer was killed; choose another"
        )
    if video is None and images is None:
        video = str(Path(file).with_suffix(".mp4"))
    check_pictures(video, images)
    outputs = ", ".join(planned(path) for path in (video, images) if path is not None)
    announce(f"{file}: {counted(len(states), 'picture')} of {scene.name} into {outputs}")
    write_pictures(scene, states, video=video, images=images, strain=strain)
    return "\n".join(f"wrote {path}" for path in (video, images) if path is not None)
