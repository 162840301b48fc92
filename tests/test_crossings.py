"""Triangles that cross: the compiled count against NumPy and ipctk, and what the benchmarks say of it."""

from dataclasses import fields, make_dataclass, replace
from pathlib import Path

import _minicloth_kernels as kernels
import numpy as np
import pytest

from cloth_envs.grid import Grid
from cloth_envs.scene import Scene
from cloth_envs.state import State
from cloth_envs.world import World
from training.bench.stability.rows import StabilityRow
from training.bench.stability.runs import Run, score
from training.metrics.contact import crossing_triangles
from training.rows import read_rows, write_rows

Pairs = set[tuple[int, int]]
GRIDS = [Grid(9, 11, 0.8, 1.0), Grid(12, 7, 1.1, 0.7, periodic=True), Grid(3, 3, 0.2, 0.2)]


def crumpled(grid: Grid, count: int, seed: int = 0) -> np.ndarray:
    """Sheets of smooth random waves whose folds pass through each other, ``(count, 3, H, W)``."""
    v, u = np.meshgrid(*(np.linspace(0, 2 * np.pi, n, endpoint=False) for n in grid.shape), indexing="ij")
    waves = np.array([np.cos(i * v + p) * np.cos(j * u + p) for i in range(4) for j in range(4) for p in (0, 1)])
    return np.tensordot(np.random.default_rng(seed).normal(size=(count, 3, len(waves))), waves, 1)


def brute(grid: Grid, cloth: np.ndarray) -> Pairs:
    """Every edge of every triangle against every triangle, by the parameters of where the line meets the plane."""
    x, faces = cloth.reshape(3, -1).T.astype(np.float64), grid.triangles
    a, b, c = x[faces].transpose(1, 0, 2)
    found = set()
    for corners in ((0, 1), (1, 2), (2, 0)):
        p, q = x[faces[:, corners]].transpose(1, 0, 2)[:, :, None]
        matrix = np.stack(np.broadcast_arrays(b - a, c - a, p - q), -1)  # (triangles of the edge, triangles, 3, 3)
        known = abs(np.linalg.det(matrix)) > 1e-14
        matrix[~known] = np.eye(3)
        u, v, t = np.moveaxis(np.linalg.solve(matrix, (p - a)[..., None])[..., 0], -1, 0)
        common = (faces[:, None, :, None] == faces[None, :, None, :]).any((2, 3))
        hits = known & ~common & (u > 0) & (v > 0) & (u + v < 1) & (t > 0) & (t < 1)
        found |= {(min(i, k), max(i, k)) for i, k in np.argwhere(hits).tolist()}
    return found


def judged(grid: Grid, cloth: np.ndarray) -> Pairs:
    """By ipctk's boxes and predicates."""
    import ipctk

    x, faces = np.ascontiguousarray(cloth.reshape(3, -1).T, np.float64), grid.triangles
    edges, broad, found = ipctk.edges(faces), ipctk.LBVH(), set()
    broad.build(x, edges, faces, 0.0)
    corners = [set(face) for face in faces.tolist()]
    owners = {edge: [i for i, own in enumerate(corners) if edge <= own] for edge in map(frozenset, edges.tolist())}
    for near in broad.detect_edge_face_candidates():
        edge, face = edges[near.edge_id], near.face_id
        if ipctk.is_edge_intersecting_triangle(*x[edge], *x[faces[face]]):
            mine = [i for i in owners[frozenset(edge.tolist())] if not corners[i] & corners[face]]
            found |= {(min(i, face), max(i, face)) for i in mine}
    return found


def listed(grid: Grid, cloth: np.ndarray) -> Pairs:
    pairs = kernels.crossing_pairs(cloth[None], periodic=grid.periodic)
    assert (pairs[:, 0] == 0).all()
    assert pairs.tolist() == sorted(pairs.tolist())
    return {(i, k) for _, i, k in pairs.tolist()}


@pytest.mark.parametrize("grid", GRIDS, ids=str)
def test_pairs_are_those_of_every_edge_and_triangle(grid: Grid) -> None:
    cloths = crumpled(grid, 2)
    told = [brute(grid, cloth) for cloth in cloths]
    assert [listed(grid, cloth) for cloth in cloths] == told
    assert crossing_triangles(grid, cloths).tolist() == [len(pairs) for pairs in told]
    assert any(told)


def test_ipctk_finds_the_same_pairs() -> None:
    pytest.importorskip("ipctk")
    for grid in (Grid(17, 15, 1.0, 0.8), Grid(14, 19, 1.0, 1.0, periodic=True)):
        for cloth in crumpled(grid, 2, seed=1).astype(np.float32):
            told = judged(grid, cloth)
            assert len(told) > 100
            assert listed(grid, cloth) == told


def test_flat_touching_and_poked_sheets() -> None:
    grid = Grid(9, 9, 0.8, 0.8)
    v, u = np.meshgrid(np.linspace(0, 0.8, 9), np.linspace(0, 0.8, 9), indexing="ij")
    flat = np.stack([u, v, 0 * u])
    folded = np.stack([abs(u - 0.4), v, 0 * u])  # its halves lie in each other
    tube = np.stack([0.2 * np.sin(6 * u), v, 0.2 * np.cos(6 * u)])  # nearly closed
    poked = tube.copy()
    middle = poked.reshape(3, -1)[:, grid.triangles[36]].mean(1)
    poked[:, 0, -1] = middle * [1.01, 1, 1.01]  # a corner of one triangle, across the tube and out through another
    cloths = np.stack([flat, folded, tube, poked])
    assert crossing_triangles(grid, cloths).tolist() == [0, 0, 0, 1]
    assert crossing_triangles(replace(grid, periodic=True), flat[None] * [[[[1]], [[1]], [[0]]]]).tolist() == [0]


def test_any_float_batch_and_threads_and_nothing_else() -> None:
    grid = Grid(17, 13, 1.0, 0.8)
    cloths = crumpled(grid, 5).astype(np.float32)
    alone = [int(crossing_triangles(grid, cloth[None])[0]) for cloth in cloths]
    for threads in (1, 2):
        for kind in (np.float32, np.float64):
            assert kernels.crossing_triangles(cloths.astype(kind), threads=threads).tolist() == alone
    for wrong in (np.nan, np.inf):
        cloths[3, 1, 2, 2] = wrong
        with pytest.raises(ValueError, match="positions must be finite"):
            crossing_triangles(grid, cloths)
    with pytest.raises(ValueError, match="positions must be"):
        kernels.crossing_triangles(cloths[:, :2])


@pytest.fixture
def folded() -> tuple[Scene, State, State]:
    """A sheet of two layers a millimetre apart; and with a vertex of one layer 2 mm nearer, through the other."""
    scene = World("Curtain", resolution=(9, 9), self_contact=True).scene
    v, u = np.meshgrid(np.linspace(0, 1.5, 9), np.linspace(-0.5, 0.5, 9), indexing="ij")
    apart = State.still(np.stack([abs(u), 0.001 * (u > 0), -v])[None], np.zeros((1, 0, 2, 3)))
    through = apart.copy()
    through.positions[0, 1, 4, 6] -= 0.002
    return scene, apart, through


def test_stability_tells_crossings_where_the_scene_has_self_contact(folded: tuple[Scene, State, State]) -> None:
    scene, apart, through = folded
    for on in (True, False):
        mine = scene.with_self_contact(on)
        good, bad = (Run(mine, [apart, apart, last, apart]) for last in (apart, through))
        found = score(bad, good, good, 3)
        assert found.crossings == crossing_triangles(scene.grid, through.positions)[0] > 0
        assert found.crossings_truth == 0
        assert found.reason == ("crossing" if on else "")
        words = f"{found.crossings:g} pairs of triangles cross, truth 0"
        assert not on or (found.failed_at, found.detail) == (2 * scene.frame_dt, words)
        assert not score(bad, bad, bad, 3).reason  # the truth's cross too
        assert not score(bad, good, good, 1).reason


def test_rows_without_the_new_columns_are_read(tmp_path: Path) -> None:
    names = [field.name for field in fields(StabilityRow) if field.name not in ("crossings", "crossings_truth")]
    old = make_dataclass("Old", names)(*range(len(names)))
    write_rows(tmp_path / "old.csv", [old])
    (row,) = read_rows(tmp_path / "old.csv", StabilityRow)
    assert np.isnan([row.crossings, row.crossings_truth]).all()
    assert [getattr(row, name) for name in names[-3:-1]] == [len(names) - 3, len(names) - 2]
    write_rows(tmp_path / "new.csv", [replace(row, crossings=2.0)])
    (again,) = read_rows(tmp_path / "new.csv", StabilityRow)
    assert again.crossings == 2
    write_rows(tmp_path / "less.csv", [make_dataclass("Less", names[1:])(*names[1:])])
    with pytest.raises(ValueError, match="other columns"):
        read_rows(tmp_path / "less.csv", StabilityRow)
