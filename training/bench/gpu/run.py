"""``minicloth bench gpu``: environments on a graphics card, beside the processor's cores in the same call."""

import argparse
from collections.abc import Mapping, Sequence
from time import perf_counter
from typing import Any

from cloth_envs.registry import EPISODE_FRAMES
from cloth_envs.vector_env import ClothVectorEnv
from surrogates.cell.backend import EMULATED
from training.bench.benchmark import Benchmark, Part, RowFile, Session
from training.bench.gpu.beside import equal, sound
from training.bench.gpu.chart import STEM, draw
from training.bench.gpu.measure import cores, name_of, speed
from training.bench.gpu.rows import (
    EqualRow,
    GpuRow,
    LearnRow,
    SoundRow,
    equal_table,
    learn_table,
    sound_table,
    speed_table,
)
from training.bench.transfer.ppo import Recipe, train

MEMBERS, MOST = (64, 512, 4096, 16384), 32  # on a card; of the processor
SECONDS = 0.25  # of each timing
BACKENDS: dict[str, dict[str, Any]] = {
    "cnn": {"backend": "cnn"},
    "miniature x4": {"backend": "miniature", "backend_kwargs": {"factor": 4}},
}
SOUND, SHARE = {"members": 4096, "steps": 500_000}, {"Flag": 14, "Collision": 6}  # times as many of cheap scenes
LEARNING = ("Flag",)
# Members and how PPO goes over their episodes: thousands on a card, few and often on the processor.
CARD = 1024, Recipe(updates=30, epochs=4, minibatch=8192, rate=2e-3)
PROCESSOR = 32, Recipe(updates=30, minibatch=400)
SEED = 6000


def options(parser: argparse.ArgumentParser) -> None:
    """What else the command takes."""
    parser.add_argument("--device", default="cuda", help="the card, or emulated: a trial of this command")
    parser.add_argument("--members", type=int, action="append", help="members on the card; may repeat")
    parser.add_argument("--only", default="speed,equal,sound,learn", help="parts, divided by commas")


def measure(session: Session) -> None:
    """What ``--only`` names, of all scenes; rows that are there are kept."""
    device, quick, wanted = session.given.device, session.quick, session.given.only.split(",")
    members = session.given.members or (MEMBERS[:1] if quick else MEMBERS)
    session.about |= {"threads": cores(), "device": device}
    if "speed" in wanted:
        for scene in session.scenes:
            for label, options in BACKENDS.items():
                fast(session, scene, label, options, members)
    if "equal" in wanted:
        for scene in session.scenes:
            count, frames = (2, 6) if quick else (32, 100)
            session.store("gpu_equal").add(equal(scene, device, count, seed=SEED, episode=frames))
    if "sound" in wanted:
        for scene in session.scenes:
            given = {"members": 2, "steps": 8} if quick else {**SOUND, "steps": SOUND["steps"] * SHARE.get(scene, 1)}
            session.store("gpu_sound").add(sound(scene, device, **given, seed=SEED + 1))
    for scene in [name for name in LEARNING if "learn" in wanted and name in session.scenes]:
        learn(session, scene, *CARD, backend_kwargs={"device": device})
        learn(session, scene, *PROCESSOR, self_contact=False, backend_kwargs={"threads": cores()})


def fast(session: Session, scene: str, label: str, options: Mapping[str, Any], members: Sequence[int]) -> None:
    """Rows of one backend on the card, and on a core and all cores of the processor."""
    store, quick = session.store(STEM), session.quick
    seconds, count = (0.2, 8) if quick else (SECONDS, MOST)
    name, device = options["backend"], session.given.device
    if name == "miniature" and device == EMULATED:
        device = "cpu"
    there = {"backend": name, "backend_kwargs": {**options.get("backend_kwargs", {}), "device": device}}
    for number in members:
        store.add(speed(scene, label, there, number, seconds=seconds))
    for threads in dict.fromkeys((1, cores())):
        store.add(speed(scene, label, {**options, "self_contact": False}, count, seconds=seconds, threads=threads))


def learn(session: Session, scene: str, players: int, recipe: Recipe, **options: Any) -> None:
    """PPO of some members on the card or on the processor."""
    frames = EPISODE_FRAMES[scene]
    if session.quick:
        players, frames, recipe = 4, 4, Recipe(updates=2, epochs=1)
    env = ClothVectorEnv(scene, num_envs=players, backend="cnn", **options)
    store, start, name = session.store("gpu_learning"), perf_counter(), name_of(env.world.device)

    def tell(update: int, reward: float) -> None:
        steps = (update + 1) * players * frames
        store.add(LearnRow(scene, name, players, update, perf_counter() - start, steps, reward))

    train(env.world, recipe, frames=frames, seed=SEED, tell=tell)


BENCHMARK = Benchmark(
    name="gpu",
    about="Environment steps a second on a graphics card, and whether it does what the processor does.",
    files={
        STEM: RowFile(GpuRow, ("scene", "backend", "rows", "members", "where", "threads")),
        "gpu_equal": RowFile(EqualRow, ("scene",)),
        "gpu_sound": RowFile(SoundRow, ("scene",)),
        "gpu_learning": RowFile(LearnRow, ("scene", "device", "members", "update")),
    },
    parts=[
        Part("Steps a second, random actions, observations and rewards included", (STEM,), speed_table),
        Part("The card's frames beside the processor's [% of length]", ("gpu_equal",), equal_table),
        Part("Random actions on the card: what ended episodes", ("gpu_sound",), sound_table),
        Part("PPO on the card and on the processor: the mean reward a frame", ("gpu_learning",), learn_table),
    ],
    measure=measure,
    charts={STEM: "Environment steps a second by members, card and processor; PPO by the clock"},
    draw=draw,
    options=options,
)
