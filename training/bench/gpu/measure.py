"""What ``minicloth bench gpu`` measures of vector environments on a card and on the processor."""

import os
from collections.abc import Mapping
from time import perf_counter
from typing import Any

import numpy as np
import torch

from cloth_envs.machine import processor
from cloth_envs.physics.gpu.card import Card
from cloth_envs.physics.gpu.solver import CardSolver
from cloth_envs.scene import Scene
from cloth_envs.vector_env import ClothVectorEnv
from training.bench.gpu.rows import GpuRow
from training.bench.throughput.terms import AHEAD, AIR, BENDING, CAPSULE, NOTHING, PLANE, PRESSURE, SPHERE, SPRINGS

LANES = 128  # FP32 units, and bytes that shared memory moves a clock, of a multiprocessor
PAIR, CELL, VECTOR = 24, 16, 12  # bytes of a vertex' positions and later ones, of a cell, of a force
BODIES = {"sphere": SPHERE, "plane": PLANE, "capsule": CAPSULE}


def operations(scene: Scene, held: float) -> float:
    """Floating-point operations of a vertex in a substep, by the law: every edge and cell once."""
    work, slow = SPRINGS, AHEAD.plus(BENDING)
    for body in scene.colliders:
        work = work.plus(BODIES[body.kind])
    slow = slow.plus(AIR if scene.air else NOTHING).plus(PRESSURE if scene.pressure else NOTHING)
    return work.operations + slow.operations / held


def shared_bytes(scene: Scene, held: float, strip: int) -> float:
    """Bytes that a vertex' threads read and write in shared memory in a substep, by the kernel's source."""
    kick = (2 * (strip + 2) + 2) / strip * PAIR + VECTOR
    bend = (2 * (strip + 2) + (strip + 3) + 2 * strip) / strip * PAIR + VECTOR
    blow = CELL + 2 * (strip + 1) / strip * CELL + PAIR + 2 * VECTOR if scene.air or scene.pressure else 0
    return kick + PAIR + (2 * PAIR + bend + blow) / held


def energy(device: torch.device) -> float:
    """What the card has used since it was started [J], NaN where nobody tells."""
    try:
        import pynvml

        pynvml.nvmlInit()
        return float(pynvml.nvmlDeviceGetTotalEnergyConsumption(pynvml.nvmlDeviceGetHandleByIndex(device.index))) / 1e3
    except (ImportError, AttributeError):
        return float("nan")


def wait(device: Any) -> None:
    """Until a card has done what it was given."""
    if device is not None and device.type == "cuda":
        torch.cuda.synchronize(device)


def timed(env: ClothVectorEnv, seconds: float) -> tuple[float, float, int]:
    """Seconds of a step, of the backend's frame in it, and how many were timed; by random actions, after a warm-up."""
    device, backend = env.world.device, env.world.backend
    generator = np.random.default_rng(0)
    drawn = [generator.uniform(-1, 1, env.action_space.shape).astype(np.float32) for _ in range(8)]
    actions: Any = drawn if device is None else [torch.as_tensor(a, device=device) for a in drawn]
    for action in actions[:3]:
        env.step(action)
    wait(device)
    start, count = perf_counter(), 0
    while count < 3 or perf_counter() - start < seconds:
        env.step(actions[count % len(actions)])
        count += 1
    wait(device)
    step = (perf_counter() - start) / count
    controls: Any = env.world.controls
    wait(device)
    start = perf_counter()
    for _ in range(count):
        backend.advance(controls)
    wait(device)
    return step, (perf_counter() - start) / count, count


def shares(backend: Any, members: int, seconds: float) -> tuple[float, float, float]:
    """Mean substeps, and of the FP32 and shared-memory peaks of a frame that took ``seconds``; NaN elsewhere."""
    backend = getattr(backend, "solver", backend)
    if not isinstance(backend, CardSolver):
        cuts = getattr(backend, "last_cuts", np.full((1, 2), np.nan))
        return float(np.mean(cuts[:, 0])), float("nan"), float("nan")
    found = backend.last_cuts.double().mean(0).tolist()
    if not isinstance(backend.runner, Card):
        return found[0], float("nan"), float("nan")
    told = torch.cuda.get_device_properties(backend.device)
    clocks = told.multi_processor_count * LANES * 1e3 * told.clock_rate * seconds
    done = members * backend.scene.grid.vertices * found[0]
    moved = shared_bytes(backend.scene, found[1], backend.runner.plan.strip)
    return found[0], done * operations(backend.scene, found[1]) / (2 * clocks), done * moved / clocks


def speed(
    scene: str, label: str, options: Mapping[str, Any], members: int, *, seconds: float, threads: int = 0
) -> GpuRow:
    """One row: on the device of the backend, or on ``threads`` of the processor."""
    options = dict(options)
    if threads:
        options["backend_kwargs"] = {**options.get("backend_kwargs", {}), "threads": threads}
    on_card = not threads
    env = ClothVectorEnv(scene, num_envs=members, output="torch" if on_card else "numpy", **options)
    env.reset(seed=0)
    device = env.world.device
    before = energy(device) if on_card and device.type == "cuda" else float("nan")
    step, frame, count = timed(env, seconds)
    used = energy(device) - before if before == before else float("nan")
    substeps, peak, moved = shares(env.world.backend, members, frame)
    grid = env.world.scene.grid
    return GpuRow(
        scene, label, *grid.shape, members, "card" if on_card else "processor", name_of(device), threads, step * 1e3,
        frame * 1e3, members / step, substeps, peak, moved, used / (2 * count * members) * 1e6,
    )  # fmt: skip


def name_of(device: Any) -> str:
    """A card's name, or the processor's."""
    return torch.cuda.get_device_name(device) if device is not None and device.type == "cuda" else processor()


def cores() -> int:
    """Processors at hand."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
