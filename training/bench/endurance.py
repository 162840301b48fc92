"""``minicloth bench endurance``: what an agent meets in a million steps of vector environments.

Every scene and backend is stepped by wild actions through ``gym.make_vec``, each policy in one of the three autoreset
modes. Nothing may raise, warn or leave the spaces; episodes that end are counted by reason.
"""

import json
import warnings
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np

from cloth_envs.grid import coarser
from cloth_envs.policies import open_loop
from cloth_envs.progress import progress
from cloth_envs.registry import EPISODE_FRAMES, env_id, load_task
from training.bench.benchmark import Benchmark, Part, RowFile, Session
from training.bench.participants import ENDURANCE, Participant, extra

STEM, SEED, MEMBERS = "endurance", 400, 32
STEPS, SLOW, QUICK = 1_000_000, 100, 1000  # in all; a backend on a coarser grid and --quick take so many times fewer
MODES = {"random": "NextStep", "bang-bang": "SameStep", "alternating": "Disabled"}  # policy -> autoreset


@dataclass(frozen=True)
class EnduranceRow:
    """One scene, backend and policy: member steps, episodes that ended and why.

    Attributes:
        truncated: at the time limit. overstretch, energy, nonfinite: failures (``cloth_envs.failure``).
        wrong: observations or rewards outside of their spaces, NaN among them. warnings: of all kinds.
        error: what was raised, or empty.
    """

    scene: str
    backend: str
    options: str
    policy: str
    rows: int
    cols: int
    steps: int
    episodes: int
    truncated: int
    overstretch: int
    energy: int
    nonfinite: int
    wrong: int
    warnings: int
    error: str


class Tally:
    """Counts what a vector environment answers."""

    def __init__(self, env: gym.vector.VectorEnv[Any, Any, Any]) -> None:
        self.env, self.ended, self.wrong, self.error = env, Counter[str](), 0, ""

    def check(self, observations: np.ndarray, rewards: np.ndarray) -> None:
        """Count members whose answer lies outside of the spaces."""
        space: Any = self.env.single_observation_space
        inside = ((observations >= space.low) & (observations <= space.high)).all(1)
        self.wrong += int((~(inside & (rewards >= 0) & (rewards <= 1))).sum())

    def run(self, actions: np.ndarray) -> None:
        """Step through ``actions`` ``(T, B, A)``, starting again whatever has ended."""
        self.env.reset(seed=SEED)
        for action in actions:
            observations, rewards, terminated, truncated, infos = self.env.step(action)
            self.check(observations, rewards)
            if terminated.any():
                self.ended.update(infos.get("final_info", infos)["failure"][terminated].tolist())
            self.ended["truncated"] += int((truncated & ~terminated).sum())
            over = terminated | truncated
            if over.any() and self.env.metadata["autoreset_mode"] is gym.vector.AutoresetMode.DISABLED:
                self.env.reset(options={"reset_mask": over})


def endure(scene: str, one: Participant, policy: str, steps: int) -> EnduranceRow:
    """About ``steps`` member steps of one scene, backend and policy."""
    shape = coarser(load_task(scene).resolution, one.coarse)
    options: dict[str, Any] = {"backend": one.backend, "backend_kwargs": one.whole, "resolution": shape}
    env = gym.make_vec(env_id(scene), num_envs=MEMBERS, autoreset_mode=MODES[policy], **options)
    world: Any = env.unwrapped
    frames, size = max(1, round(steps / MEMBERS)), env.single_action_space.shape[0]  # type: ignore[index]
    actions = np.stack([open_loop(policy, frames, size, world.scene.frame_dt, SEED + i) for i in range(MEMBERS)], 1)
    tally = Tally(env)
    with warnings.catch_warnings(record=True) as heard, np.errstate(all="warn"):
        warnings.simplefilter("always")
        try:
            tally.run(actions)
        except Exception as error:
            tally.error = f"{type(error).__name__}: {error}"
    ended = tally.ended
    return EnduranceRow(
        scene, one.label, json.dumps(one.whole), policy, *shape, frames * MEMBERS,
        ended.total(), ended["truncated"], ended["overstretch"], ended["energy"], ended["non-finite"],
        tally.wrong, len(heard), tally.error,
    )  # fmt: skip


def table(rows: Sequence[EnduranceRow]) -> str:
    """Steps, episodes and how they ended, by backend and scene over all policies, and their sum."""
    names = ("steps", "episodes", "truncated", "overstretch", "energy", "nonfinite", "wrong", "warnings")
    lines = [f"{'':32s}" + "".join(f"{name:>13s}" for name in names) + "   raised"]
    groups = dict.fromkeys((r.backend, r.scene) for r in rows)
    for title, mine in [
        *((f"{key[0]:22s}{key[1]:10s}", [r for r in rows if (r.backend, r.scene) == key]) for key in groups),
        ("all", rows),
    ]:
        sums = "".join(f"{sum(getattr(r, name) for r in mine):13,d}" for name in names)
        lines.append(f"{title:32s}{sums}   {sum(bool(r.error) for r in mine) or ''}".rstrip())
    return "\n".join(lines)


def measure(session: Session) -> None:
    """Every scene, backend and policy that is missing."""
    participants, store = [*ENDURANCE, *extra(session.given.backend)], session.store(STEM)
    full = [p for p in ENDURANCE if p.coarse == 1]
    each = STEPS / (len(full) * len(session.benchmark.scenes) * len(MODES)) / (QUICK if session.quick else 1)
    session.about |= {"seed": SEED, "members": MEMBERS, "autoreset": MODES, "frames": EPISODE_FRAMES}
    cells = [(scene, one, policy) for one in participants for scene in session.scenes for policy in MODES]
    for scene, one, policy in progress(cells, STEM):
        if (scene, one.label, json.dumps(one.whole), policy) not in store:
            steps = each / SLOW if one.coarse > 1 else each
            store.add(endure(scene, one, policy, round(steps)))


BENCHMARK = Benchmark(
    name=STEM,
    about="What an agent meets in a million wild steps: how episodes end, and that nothing raises, warns or is NaN.",
    files={STEM: RowFile(EnduranceRow, ("scene", "backend", "options", "policy"))},
    parts=[Part("Member steps and how episodes ended", (STEM,), table)],
    measure=measure,
)
