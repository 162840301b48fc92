"""The torch cell against its NumPy twin, the laws that its form keeps, and how it learns."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from cloth_envs.grid import Grid
from cloth_envs.particles import Particles
from cloth_envs.physics.laws import particles as twin
from cloth_envs.physics.particles.solver import NEIGHBOURS, Cell, mass_spring_cell
from cloth_envs.scene import Collider, Scene
from cloth_envs.state import Controls, State
from surrogates.cell.engine import TorchNet
from surrogates.cell.stencil import BRANCHES, StencilCell
from training.cell.data import Sums, accelerations, design, links
from training.cell.solve import Loss, Recipe, Stage, as_cell, branch_scales, least_squares, numbers_of, train
from training.cell.train import adam
from training.fit import Kept

EPS = np.finfo(float).eps
NET = Particles()


def make_scene(rows: int = 7, cols: int = 9, **options: object) -> Scene:
    grid = Grid(rows, cols, (rows - 1) * NET.spacing, (cols - 1) * NET.spacing)
    return Scene("net", grid, NET.sheet(), NET.sim_dt, particles=NET, **{"gravity": 9.8, **options})  # type: ignore[arg-type]


def crumpled(scene: Scene, batch: int = 2, amount: float = 0.15, seed: int = 0) -> State:
    """Random positions ``amount`` spacings around flat, velocities of about 1 m/s, a ball at the middle."""
    rng = np.random.default_rng(seed)
    r, c = np.indices(scene.grid.shape) * NET.spacing
    x = np.stack([c, -r, 0 * r]) + amount * NET.spacing * rng.normal(size=(batch, 3, *scene.grid.shape))
    centre = x.mean((2, 3))[:, None, None] + [0, 0, -0.02]
    state = State.still(x, np.broadcast_to(centre, (batch, len(scene.colliders), 2, 3)))
    state.velocities[:] = rng.normal(size=x.shape)
    return state


def random_cell(seed: int = 3) -> Cell:
    rng = np.random.default_rng(seed)
    return Cell(rng.normal(size=(12, 3)) * [1e6, 1e4, 200], rng.normal(size=3), eps=1e-9)


def tensors(state: State) -> tuple[torch.Tensor, torch.Tensor]:
    return torch.from_numpy(state.positions), torch.from_numpy(state.velocities)


def learner(seed: int = 0, **options: object) -> StencilCell:
    """A cell of random parameters in (0, 1) times the usual scales."""
    cell = StencilCell(scales=(1e4, 1.0, 200.0, -10.0), dtype=torch.float64, **options)  # type: ignore[arg-type]
    generator = torch.Generator().manual_seed(seed)
    for parameter in cell.parameters():
        parameter.data = torch.rand(parameter.shape, generator=generator, dtype=torch.float64)
    return cell


def rest_lengths() -> torch.Tensor:
    return torch.tensor(np.hypot(*(NEIGHBOURS * NET.spacing).T))


def test_kernels_are_fixed_differences() -> None:
    near, far = StencilCell().near, StencilCell().far
    assert (near.shape, far.shape) == ((8, 1, 3, 3), (4, 1, 3, 3))
    assert {name for name, _ in learner().named_parameters()} == set(BRANCHES)
    for kernel in (*near, *far):
        assert sorted(kernel.flatten().tolist()) == [-1.0] + [0.0] * 7 + [1.0]
    # A field that holds its own flat number tells which neighbour each channel looks at, where there is one.
    field = torch.arange(35.0).reshape(1, 1, 5, 7)
    centre = StencilCell().differences(field)[0, 0, :, 2, 3]
    assert centre.tolist() == [7.0 * down + right for down, right in NEIGHBOURS.tolist()]


@pytest.mark.parametrize("shape", [(7, 9), (3, 3), (4, 3)])
def test_forces_are_the_twins_borders_included(shape: tuple[int, int]) -> None:
    state, cell = crumpled(make_scene(*shape)), random_cell()
    want = twin.cell_forces(cell, state.positions, state.velocities)
    got = StencilCell.of(cell, dtype=torch.float64)(*tensors(state)).detach().numpy()
    # Twelve terms alpha d of 1e6 N/m times spacings, summed in another order.
    assert abs(got - want).max() <= 12 * 4 * EPS * abs(cell.coefficients[:, 0]).max() * 3 * NET.spacing


def test_a_step_of_everything_is_the_twins() -> None:
    scene = make_scene(pressure=True, colliders=(Collider("sphere", 0.03),), handles=(0, 8))
    state, cell = crumpled(scene), random_cell()
    controls = Controls.hold(state, scene.handles)
    controls.handle_positions += 1e-4
    controls.handle_velocities += 0.3
    controls.pressure[:] = [150_000.0, -40_000.0]
    want = twin.step(scene, state, controls, cell, in_place=False)
    bare = twin.step(replace(scene, colliders=()), state, controls, cell, in_place=False)
    solver = TorchNet(scene, cell, num_envs=2, dtype="float64")
    solver.reset(state)
    after = solver.advance(controls)
    for got, wanted in ((after.positions, want.positions), (after.velocities, want.velocities)):
        # Forces' rounding of the test above, times h / m: under 1e-9 of velocities of up to a few hundred m/s.
        assert abs(got - wanted).max() <= 1e-12 * abs(want.velocities).max()
    assert abs(want.velocities - bare.velocities).max() > 0.1


def test_plugged_in_forces_are_added() -> None:
    scene = make_scene()
    state, push = crumpled(scene), torch.tensor([1.0, -2.0, 3.0], dtype=torch.float64)[:, None, None]
    ends = []
    for forces in ((), [lambda x, v: push + 0 * x]):
        solver = TorchNet(scene, mass_spring_cell(scene), num_envs=2, dtype="float64", forces=forces)
        solver.reset(state)
        ends.append(solver.advance(Controls.hold(state, ())).velocities)
    want = np.exp(-NET.drag * NET.sim_dt) * NET.sim_dt / NET.node_mass * push.numpy()
    # Rounding of velocities of up to a few hundred m/s.
    np.testing.assert_allclose(ends[1] - ends[0], np.broadcast_to(want, ends[0].shape), rtol=0, atol=1e3 * EPS)


def test_pairs_keep_momentum_whatever_was_learned() -> None:
    x, v = tensors(crumpled(make_scene()))
    pairs, free = learner(pairs=True), learner()
    for cell in (pairs, free):
        cell.bias.data[:] = 0
    with torch.no_grad():
        kept, lost = (cell(x, v) for cell in (pairs, free))
    largest = float(kept.abs().max())
    assert float(kept.sum((2, 3)).abs().max()) < 63 * 12 * EPS * largest  # as many terms as particles and neighbours
    assert float(lost.sum((2, 3)).abs().max()) > 1e-3 * largest
    moment = torch.linalg.cross(x, kept, dim=1).sum((2, 3)).abs().max()
    assert float(moment) < 63 * 12 * EPS * largest * float(x.abs().max())


def test_the_isru_turns_with_the_cloth() -> None:
    """By component it could not hold the law: below."""
    x, v = tensors(crumpled(make_scene()))
    turn = torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64))[0]

    def turned(a: torch.Tensor) -> torch.Tensor:
        return torch.einsum("ij,bjhw->bihw", turn, a)

    cell = learner()
    cell.bias.data[:] = 0
    with torch.no_grad():
        before, after = turned(cell(x, v)), cell(turned(x), turned(v))
    # Rounding of alpha d (1e4 N/m here) next to forces of about beta.
    assert float((after - before).abs().max()) < 1e-11 * float(before.abs().max())


def test_lengths_change_the_basis_and_not_the_forces() -> None:
    cell = learner(lengths=rest_lengths(), pairs=True)
    x, v = tensors(crumpled(make_scene()))
    with torch.no_grad():
        same = StencilCell.of(as_cell(numbers_of(cell).detach().numpy()), dtype=torch.float64)(x, v)
        assert torch.allclose(cell(x, v), same, rtol=0, atol=1e-12 * float(same.abs().max()))
    alpha, beta, _, _ = cell.branches()
    assert torch.allclose(alpha * rest_lengths() + beta, cell.nonlinear.repeat_interleave(2))
    with pytest.raises(ValueError, match="positive"):
        StencilCell(eps=0.0)


def samples(count: int = 12) -> tuple[np.ndarray, np.ndarray, list[State]]:
    """Rows of ``design``, accelerations and states of random nets, all particles."""
    scene = make_scene()
    at = links(*scene.grid.shape, np.arange(scene.grid.vertices))
    states = [crumpled(scene, 1, seed=seed) for seed in range(count)]
    blocks = [design(*(a[0].reshape(3, -1) for a in (s.positions, s.velocities)), at) for s in states]
    return np.stack(blocks), np.stack([accelerations(scene, s).ravel() for s in states]), states


def forms(blocks: np.ndarray, wanted: np.ndarray) -> Loss:
    whole = np.concatenate([blocks, wanted[:, None]], 1)
    return Loss(whole @ whole.swapaxes(1, 2) / wanted.shape[1])


def test_the_loss_is_the_mean_square_on_states_and_so_is_its_slope() -> None:
    """Eq. 8 from sums of squares against the torch cell run on the states."""
    blocks, wanted, states = samples(3)
    cell, form = learner(), torch.from_numpy(forms(blocks, wanted).forms.mean(0))
    direct = torch.stack(
        [((cell(*tensors(s)).flatten() - torch.from_numpy(a)) ** 2).mean() for s, a in zip(states, wanted, strict=True)]
    ).mean()
    full = torch.cat([numbers_of(cell), -torch.ones(1, dtype=torch.float64)])
    quick = full @ form @ full
    # The form holds squares of alpha d, (1e4 N)^2 12 and more, of which the loss is what is left.
    assert quick.item() == pytest.approx(direct.item(), rel=1e-9)
    slopes = [torch.autograd.grad(value, list(cell.parameters()), retain_graph=True) for value in (direct, quick)]
    for one, other in zip(*slopes, strict=True):
        assert torch.allclose(one, other, rtol=1e-8)


def test_least_squares_finds_the_law() -> None:
    blocks, wanted, _ = samples()
    found = as_cell(least_squares((np.concatenate(blocks, 1), np.concatenate(wanted))).numbers)
    law = mass_spring_cell(make_scene())
    # eps of 1e-12 m^2 shortens n by eps / (2 d^2), 2e-8 where springs are half their length, and rounding some.
    assert abs(found.coefficients / law.coefficients - 1).max() < 1e-6
    assert abs(found.bias - law.bias).max() < 1e-6 * 9.8


def test_a_component_wise_isru_cannot_hold_the_law() -> None:
    scene = make_scene()
    at = links(*scene.grid.shape, np.arange(scene.grid.vertices))
    errors = {}
    for vector in (True, False):
        blocks, wanted = [], []
        for seed in range(12):
            s = crumpled(scene, 1, 0.15, seed)
            turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]  # not along the axes
            s.positions, s.velocities = (np.einsum("ij,bjhw->bihw", turn, a) for a in (s.positions, s.velocities))
            blocks.append(design(*(a[0].reshape(3, -1) for a in (s.positions, s.velocities)), at, vector=vector))
            wanted.append(accelerations(scene, s).ravel())
        block, target = np.concatenate(blocks, 1), np.concatenate(wanted)
        errors[vector] = np.linalg.norm(least_squares((block, target)).numbers @ block - target) / np.linalg.norm(
            target
        )
    assert errors[True] < 1e-6 < 0.3 < errors[False]


def test_evolution_then_adam_finds_the_law_and_frozen_branches_stay() -> None:
    blocks, wanted, _ = samples(16)
    loss = forms(blocks, wanted)
    scales, _ = branch_scales(loss, rest_lengths())
    assert np.sign(scales[0]) == np.sign(scales[2]) == 1
    assert scales[3] < 0
    assert scales[0] == pytest.approx(NET.stiffness, rel=0.05)
    cell = StencilCell(scales=scales, lengths=rest_lengths(), pairs=True, dtype=torch.float64)
    stages = [Stage(1e-2, 300, "step"), Stage(1e-3, 50, "cosine"), Stage(1e-3, 20, "cosine", ("derivative",))]
    start = loss(numbers_of(cell).detach().numpy())
    for stage in stages[:2]:
        train(cell, loss, stage, batch=4)
    before = {name: getattr(cell, name).detach().clone() for name in BRANCHES}
    end, _ = train(cell, loss, stages[2], batch=4)
    changed = [name for name in BRANCHES if not torch.equal(before[name], getattr(cell, name))]
    assert changed == ["derivative"]
    law, alpha = mass_spring_cell(make_scene()).coefficients, cell.branches()[0].detach().numpy()
    assert end < 1e-4 * start
    assert abs(alpha / law[:, 0] - 1).max() < 0.01


def test_training_goes_on_where_it_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stopped: Callable[[int], AbstractContextManager[object]]
) -> None:
    """All stages at once, and again with a stop in the second one."""
    blocks, wanted, _ = samples(8)
    small, recipe = Sums(forms(blocks, wanted).forms, np.zeros((8, 40, 40))), Recipe("fall", epochs=8, batch=4)
    monkeypatch.setattr("training.cell.train.sums", lambda *_: small)
    monkeypatch.setattr("training.cell.train.branch_scales", lambda *_: ((1e4, 1.0, 200.0, -10.0), 0.0))
    whole, _ = adam(recipe, tmp_path / "whole")
    with stopped(17):  # two batches an epoch: 16 steps of the first stage
        adam(recipe, tmp_path / "parts")
    assert len(list((tmp_path / "parts").iterdir())) == 1
    again, about = adam(recipe, tmp_path / "parts")
    assert np.array_equal(again.numbers, whole.numbers)
    assert len(about["loss after each stage"]) == 3


@pytest.mark.parametrize("schedule", ["step", "cosine"])
def test_a_stage_goes_on_between_epochs(
    tmp_path: Path, schedule: str, stopped: Callable[[int], AbstractContextManager[object]]
) -> None:
    blocks, wanted, _ = samples(8)
    loss, stage, cells = forms(blocks, wanted), Stage(1e-2, 12, schedule), [learner(), learner()]
    train(cells[0], loss, stage, batch=4)
    kept = Kept(tmp_path / "stage.pt", "", every=5)  # two batches an epoch: every 6 steps
    with stopped(15):
        train(cells[1], loss, stage, batch=4, kept=kept)
    cells[1] = learner(1)
    train(cells[1], loss, stage, batch=4, kept=kept)
    assert all(torch.equal(a, b) for a, b in zip(*(cell.parameters() for cell in cells), strict=True))
