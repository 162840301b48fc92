"""The backend "cnn": the same cell in torch and compiled, on the paper's particles and on the six scenes."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch

import cloth_envs
from cloth_envs.grid import Grid
from cloth_envs.particles import Particles
from cloth_envs.physics.particles.solver import Cell, mass_spring_cell
from cloth_envs.registry import PRESETS, SCENES, make_backend
from cloth_envs.scene import Collider, Scene
from cloth_envs.state import Controls, State
from cloth_envs.world import World
from surrogates import checkpoint
from surrogates.cell.compiled import CLASSES, CellNet, CellSheet, dimensional, dimensionless
from surrogates.cell.engine import TorchNet
from training.bench.papers import cell as cnn
from training.bench.papers.cell import CELL_KEY, CellRow
from training.bench.papers.large_step import growth
from training.cell.data import KNOWABLE
from training.cell.score import EXACT, Run, errors
from training.cell.sheets import columns, identify, solve
from training.cell.solve import as_cell, least_squares, rows
from training.cell.train import main
from training.rows import Store

EPS = {"float32": np.finfo(np.float32).eps, "float64": np.finfo(np.float64).eps}
NETS = [(scene, preset) for preset in ("zhao2024", "zhao2024-fall") for scene in PRESETS[preset]]
NET = Particles()


def small_net(**options: object) -> Scene:
    grid = Grid(8, 11, 7 * NET.spacing, 10 * NET.spacing)
    given = {"gravity": 9.8, "pressure": True, "handles": (0, 10), "colliders": (Collider("sphere", 0.03),)}
    return Scene("net", grid, NET.sheet(), 8 * NET.sim_dt, **(given | {"particles": NET} | options))  # type: ignore[arg-type]


def crumpled(scene: Scene, batch: int = 2, amount: float = 0.15) -> State:
    rng = np.random.default_rng(0)
    r, c = np.indices(scene.grid.shape) * scene.grid.row_spacing
    x = np.stack([c, -r, 0 * r]) + amount * scene.grid.row_spacing * rng.normal(size=(batch, 3, *scene.grid.shape))
    bodies = np.broadcast_to(x.mean((2, 3))[:, None, None] + [0, 0, -0.02], (batch, len(scene.colliders), 2, 3))
    state = State.still(x, bodies)
    state.velocities[:] = rng.normal(size=x.shape)
    return state


def learned(scene: Scene) -> Cell:
    """A cell a few percent off the law, every neighbour its own way."""
    rng = np.random.default_rng(5)
    off = {"coefficients": 1 + 0.03 * rng.normal(size=(12, 3)), "bias": np.array([0.01, 0.02, -1.0])}
    return dimensional(scene, {**off, "eps": np.array([1e-12])})


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_torch_and_the_kernel_run_the_same_cell(dtype: str) -> None:
    scene = small_net()
    state = crumpled(scene)
    controls = Controls.hold(state, scene.handles)
    controls.handle_positions += 1e-4
    controls.colliders += 2e-4
    controls.collider_velocities += [0.2, 0.1, 0.4]
    controls.pressure[:] = [150_000.0, -40_000.0]
    ends = []
    for backend in (CellNet, TorchNet):
        solver = backend(scene, learned(scene), num_envs=2, dtype=dtype)  # type: ignore[operator]
        solver.reset(state)
        ends.append(solver.advance(controls))
    # As between the kernel and its twin (tests/test_particles.py): eight steps in each of which a rounding of a
    # position becomes 400 1/s * 11 spacings of it.
    bound = 8 * 400 * EPS[dtype]
    for name in ("positions", "velocities"):
        one, other = (getattr(end, name) for end in ends)
        assert one.dtype == other.dtype == dtype
        assert abs(one - other).max() <= bound * abs(one).max(), name
    assert abs(ends[0].velocities - state.velocities).max() > 0.1


def test_a_cell_fitted_at_one_material_steps_another() -> None:
    """Least squares at Y = 1e4; then particles four times as stiff, thrice as heavy and half as damped."""
    block, wanted = rows(("fall", "blow"), 3, 300, steps=300)
    found = as_cell(least_squares((block, wanted)).numbers)
    arrays = dimensionless(small_net(), found)
    assert abs(arrays["coefficients"] - 1).max() < 1e-3  # the first 0.1 s stretch the net little
    other = replace(NET, stiffness=4e4, node_mass=3.0, dashpot=100.0)
    scene = small_net(particles=other)
    ends = []
    for solver in (
        CellNet(scene, mass_spring_cell(scene), num_envs=2, dtype="float64"),
        CellNet(scene, dimensional(scene, arrays), num_envs=2, dtype="float64"),
    ):
        solver.reset(crumpled(scene))
        ends.append(solver.advance(Controls.hold(solver.state, scene.handles)))
    moved = abs(ends[0].positions - crumpled(scene).positions).max()
    assert moved > 1e-3
    # Numbers off by 1e-3 move it otherwise by about as much of the way.
    assert abs(ends[1].positions - ends[0].positions).max() < 2e-3 * moved
    # Without the conditioning it would be far off.
    wrong = CellNet(scene, found, num_envs=2, dtype="float64")
    wrong.reset(crumpled(scene))
    assert (
        abs(wrong.advance(Controls.hold(wrong.state, scene.handles)).positions - ends[0].positions).max() > 0.1 * moved
    )


@pytest.mark.parametrize("scene", SCENES)
def test_sheets_are_identified_from_the_references_steps(scene: str) -> None:
    found = identify(scene, frames=(2, 4))
    # Exact data of an exact law, so what is left is rounding: a substep's change of a velocity, about 1e-4 of it, is
    # known to eps / 1e-4 = 2e-12, and bending is a millionth of the forces.
    assert abs(found.factors - 1).max() < 1e-6
    assert found.error < 1e-9
    assert abs(found.sideways).max() < 1e-9


def test_a_class_of_edges_that_differs_is_seen() -> None:
    """Forces of a made-up sheet, stiffer down than along and pulled sideways, give its numbers back."""
    scene = World("Hanging", resolution=(9, 8)).scene
    state = crumpled(scene, 1, 0.05)
    block = columns(scene, state.positions[0].reshape(3, -1), state.velocities[0].reshape(3, -1))
    truth = 1 + 0.1 * np.arange(len(CLASSES))
    assert np.allclose(solve(block, truth @ block), truth, rtol=1e-6)


@pytest.mark.parametrize("scene", SCENES)
def test_a_sheet_moves_as_the_reference_does(scene: str) -> None:
    shape = (13, 11)
    worlds = [World(scene, backend=b, resolution=shape, material="silk") for b in ("reference", "cnn")]
    action = np.random.default_rng(0).uniform(-1, 1, (1, len(worlds[0].task.actions)))
    for world in worlds:
        world.reset({0: np.random.default_rng(4)})
        for _ in range(5):
            world.step(action)
    a, b = (world.state.positions for world in worlds)
    # Factors off by under 1e-9 do not show next to float32; a few hundred substeps of rounding do.
    assert abs(a - b).max() < 2000 * EPS["float32"]
    assert isinstance(worlds[1].backend, CellSheet)
    assert worlds[1].scene.gravity == worlds[0].scene.gravity


@pytest.mark.parametrize(("scene", "preset"), NETS)
def test_shipped_cells_move_the_papers_nets_as_their_law_does(scene: str, preset: str) -> None:
    cell, simulator = (World(scene, backend=b, preset=preset) for b in ("cnn", "reference"))
    for world in (cell, simulator):
        world.reset({0: np.random.default_rng(0)})
    start, law = cell.state, CellNet(cell.scene, mass_spring_cell(cell.scene))
    law.reset(start)
    assert cell.episode is not None
    law.advance(cell.task.controls(cell.episode))
    for world in (cell, simulator):
        world.step(np.zeros((1, len(world.task.actions))))
    one, other, true = (state.positions for state in (cell.state, law.state, simulator.state))
    moved = abs(one - start.positions).max()
    # Numbers within 0.1 % (below) over a frame, and float32 twice.
    assert abs(one - other).max() < 1e-3 * moved + 64 * EPS["float32"]
    # The simulator's order is no convolution's: a dashpot hands c h / m = 7 % of a particle's step on to the next.
    assert abs(one - true).max() < 0.07 * moved


@pytest.mark.parametrize("name", ["", "_fall", "_blow", "_least_squares"])
def test_shipped_cells_are_the_law_within_a_thousandth(name: str) -> None:
    arrays, card = checkpoint.load(f"cnn_particles{name}")
    assert abs(arrays["coefficients"] - 1).max() < 1e-3
    assert abs(arrays["bias"] - [0, 0, -1]).max() < 1e-3
    assert card["licence"] == "MIT"
    for needed in ("recipe", "data sha256", "valid", "seconds of the fit"):
        assert card[needed]


@pytest.mark.parametrize(("scene", "preset"), [(scene, None) for scene in SCENES] + NETS[:3])
def test_spaces_and_save_and_restore_are_those_of_the_scene(scene: str, preset: str | None) -> None:
    options = {"preset": preset} if preset else {}
    with (
        gym.make(cloth_envs.env_id(scene), backend="cnn", **options) as env,
        gym.make(cloth_envs.env_id(scene), **options) as plain,
    ):
        assert env.action_space == plain.action_space
        assert env.observation_space == plain.observation_space
        assert env.spec.max_episode_steps == plain.spec.max_episode_steps
        assert np.array_equal(env.reset(seed=3)[0], plain.reset(seed=3)[0])
        action = np.random.default_rng(0).uniform(-1, 1, env.action_space.shape).astype(np.float32)
        env.step(action)
        saved = env.unwrapped.get_state()
        first = env.step(action)[0]
        env.reset(seed=9)
        env.unwrapped.set_state(saved)
        assert np.array_equal(env.step(action)[0], first)


def test_forces_plug_into_the_torch_engine() -> None:
    world = World("Hanging", preset="zhao2024")
    world.reset({0: np.random.default_rng(0)})
    push = torch.tensor([0.0, 5.0, 0.0])[:, None, None]
    scene = replace(world.scene, frame_dt=4 * NET.sim_dt)
    ends = []
    for forces in ((), (lambda x, v: push + 0 * x,)):
        backend = make_backend("cnn", scene, backend_kwargs={"engine": "torch", "forces": forces})
        backend.reset(world.state)
        ends.append(backend.advance(Controls.hold(backend.state, scene.handles)).velocities[0, 1])
    # 5 N on 1 kg over four steps of drag; away from the pinned corner all particles get it alike.
    q, h = np.exp(-NET.drag * NET.sim_dt), NET.sim_dt
    want = 5 * h * (q + q**2 + q**3 + q**4)
    assert (ends[1] - ends[0])[64:, 64:] == pytest.approx(want, rel=1e-3)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"engine": "tourch"}, ["'torch'"]),
        ({"weights": "cnn_particle"}, ["'cnn_particles'"]),
        ({"weights": "cnn_particles"}, ["particles", "leave weights out"]),
        ({"forces": [abs]}, ['engine="torch"']),
        ({"thread": 2}, ["'threads'"]),
    ],
)
def test_bad_arguments_name_the_remedy(options: dict[str, object], words: list[str]) -> None:
    scene = World("Flag", resolution=(7, 7)).scene
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        make_backend("cnn", scene, backend_kwargs=options)
    assert all(word in str(caught.value) for word in words), str(caught.value)


def test_the_trainer_says_what_it_does_not_know(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="'Curtain'"):
        main(["--scenes", "Curtin", "--out", str(tmp_path)])
    assert main(["--scenes", "Flag", "--no-particles", "--out", str(tmp_path)]) == 0
    found = checkpoint.load("cnn_flag", tmp_path)
    assert found.arrays["factors"].shape == (5,)
    assert found.card["relative error of forces, held out (seed 200)"] < 1e-9


def test_the_compiled_engine_does_not_import_torch() -> None:
    code = (
        "import sys; from cloth_envs.world import World; World('BallDrop', backend='cnn', preset='zhao2024');"
        "from cloth_envs.vector_env import ClothVectorEnv; ClothVectorEnv('Flag', backend='cnn').reset();"
        "sys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_table_2_has_its_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = Store(tmp_path / "cnn.csv", CellRow, CELL_KEY)
    monkeypatch.setitem(KNOWABLE, "hang", 2)
    cnn.score(store, 3)
    found = {(row.scene, row.run): row for row in Store(store.path, CellRow, CELL_KEY).rows}
    assert {scene for scene, _ in found} == set(cnn.CASES)
    assert found["fall", "cnn_particles_fall"].paper == 0.213
    # Three steps of float32 next to a metre.
    assert 0 < found["ball", "simulator, float32"].whole < 100 * 16 * EPS["float32"]
    # Nobody knows where the hanging net is later.
    assert {row.steps for row in store.rows if row.scene == "hang"} == {2}
    assert "cnn_particles_blow" in cnn.table(store.rows, [], [])


def test_a_convolution_reaches_the_simulator_but_for_its_order() -> None:
    """A tenth of a second of "fall": the law on old velocities is off by more than all of the simulator's float32."""
    runs = {"law": Run(EXACT), "cell": Run(checkpoint.load("cnn_particles").arrays), "float32": Run(None, "float32")}
    found = errors("fall", runs, 300)
    assert found["law"].whole > 10 * found["float32"].whole
    assert found["cell"].whole == pytest.approx(found["law"].whole, rel=0.01)


@pytest.mark.parametrize(("ratio", "cells"), [(1.0, 1), (2.0, 1), (2.0, 2), (3.0, 2), (3.0, 3)])
def test_cells_cannot_step_further_than_as_many_explicit_steps(ratio: float, cells: int) -> None:
    """Markov's inequality: the least growth is 1 up to ``ratio = cells``; one cell's is that of explicit Euler."""
    found = growth(ratio, cells)
    assert (found < 1 + 1e-3) == (ratio <= cells)
    if cells == 1:
        b = max(1.0, 2 * ratio**2 - 1)  # |1 - z / 2| at z = 4 R^2
        assert found == pytest.approx(b + np.sqrt(b * b - 1), rel=1e-6)
