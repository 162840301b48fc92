"""Every metric on a case computed by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.scene import Collider, Scene
from cloth_envs.state import State
from training import metrics
from training.metrics import contact, detail, errors, spectra

GRID = Grid(9, 13, 0.8, 1.2)  # spacing 0.1 m
V, U = (0.1 * i for i in np.indices(GRID.shape))


def sheet(x: object = U, y: object = V, z: object = 0.0) -> np.ndarray:
    """Positions ``(1, 3, 9, 13)`` of any three fields."""
    return np.stack([np.broadcast_to(c, GRID.shape) for c in (x, y, z)]).astype(float)[None]


def rolled(radius: float) -> np.ndarray:
    """The sheet on a cylinder about the rows' axis."""
    return sheet(radius * np.sin(U / radius), V, radius * np.cos(U / radius))


FLAT = sheet()


def test_distances_of_a_shift_and_of_one_vertex() -> None:
    moved = FLAT + np.array([0.0, 0.03, 0.04])[:, None, None]
    assert errors.distances(moved, FLAT) == pytest.approx(0.05)  # 3, 4, 5
    assert [float(e[0]) for e in errors.vertex_error(moved, FLAT, 1.2)] == pytest.approx([100 * 0.05 / 1.2] * 3)
    one = FLAT.copy()
    one[0, 2, 4, 4] += 0.117
    found = errors.vertex_error(one, FLAT, 1.2)
    # 117 vertices: the mean is 0.001 m, 95 % of them do not move at all.
    assert [float(e[0]) for e in found] == pytest.approx([0.1 / 1.2, 0.0, 11.7 / 1.2])
    assert errors.largest(moved, FLAT) == pytest.approx(0.04)
    assert errors.vmse(moved, FLAT) == pytest.approx(0.0025)
    with pytest.raises(ValueError, match="resample"):
        errors.distances(FLAT, FLAT[..., :-1])


def test_relative_l2() -> None:
    """A sheet twice as wide is as far from the sheet as that reaches from its centre, wherever the origin is."""
    centred = FLAT - FLAT.mean((2, 3), keepdims=True)
    assert errors.relative_l2(2 * centred + 5, centred + 5) == pytest.approx(1)
    assert errors.relative_l2(FLAT + 100, FLAT + 100) == 0


def test_psnr_of_a_tenth_of_the_range_is_20_db() -> None:
    assert errors.psnr(FLAT + 0.05, FLAT, 0.5) == pytest.approx(20)
    # Only the first of three axes is wrong: a third of the mean square.
    one = FLAT + np.array([0.1, 0, 0])[:, None, None]
    assert errors.psnr(one, FLAT, np.array([1.0, 2, 3])) == pytest.approx(20 + 10 * np.log10(3))
    assert np.isinf(errors.psnr(FLAT, FLAT, 1.0)).all()
    moving = np.concatenate([FLAT, FLAT + np.array([0.2, -0.1, 0.7])[:, None, None]])
    assert errors.displacement_span(moving, FLAT[0]) == pytest.approx([0.2, 0.1, 0.7])
    with pytest.raises(ValueError, match="positive"):
        errors.psnr(FLAT, FLAT, 0.0)


def test_flicker_is_the_error_of_the_acceleration() -> None:
    """A vertical error 0, 0, d, 0 has second differences d and -2 d; steady drift has none."""
    dt, d = 0.02, 1e-3
    truth = np.concatenate([FLAT] * 4)
    jump = truth.copy()
    jump[2, 2] += d
    assert errors.flicker(jump, truth, dt) == pytest.approx([d / dt**2, 2 * d / dt**2])
    drift = truth + 0.01 * np.arange(4)[:, None, None, None]
    assert errors.flicker(drift, truth, dt) == pytest.approx([0, 0], abs=1e-9)
    with pytest.raises(ValueError, match="three frames"):
        errors.flicker(truth[:2], truth[:2], dt)


def test_normals_and_their_angle() -> None:
    tilt = np.radians(30)
    tilted = sheet(U * np.cos(tilt), V, U * np.sin(tilt))
    assert detail.normal_angle(GRID, tilted, FLAT) == pytest.approx(30)
    assert detail.normal_angle(GRID, FLAT[:, :, ::-1], FLAT) == pytest.approx(180)  # turned over
    # Turned as the triangles: rows down the page are y here, so the first triangle's normal points along -z.
    x = FLAT[0].reshape(3, -1).T[GRID.triangles[0]]
    n = np.cross(x[1] - x[0], x[2] - x[0])
    assert detail.normals(GRID, FLAT)[0, :, 4, 4] == pytest.approx(n / np.linalg.norm(n))
    tube = replace(GRID, periodic=True)
    angle = 2 * np.pi * np.indices(GRID.shape)[1] / GRID.cols
    outward = detail.normals(tube, sheet(np.cos(angle), np.sin(angle), -V))[0, :2]
    np.testing.assert_allclose(np.abs(outward[0] * np.cos(angle) + outward[1] * np.sin(angle)), 1)


def test_mean_curvature_of_cylinders() -> None:
    """1/(2 R); chords of angle a = spacing/R have 2 R (1 - cos a) / spacing^2 instead of 1/R."""

    def exact(radius: float) -> float:
        return radius * (1 - np.cos(0.1 / radius)) / 0.01

    for radius in (0.4, 0.8):
        assert np.abs(detail.mean_curvature(GRID, rolled(radius))) == pytest.approx(exact(radius))
        assert exact(radius) == pytest.approx(1 / (2 * radius), rel=(0.1 / radius) ** 2 / 12)
    both = detail.curvature_distance(GRID, rolled(0.4), rolled(0.8))
    assert both == pytest.approx(exact(0.4) - exact(0.8))
    # A histogram: where the bumps are does not matter.
    bumpy = sheet(z=0.02 * np.sin(np.pi * U / 0.3))
    assert detail.curvature_distance(GRID, bumpy[..., ::-1], bumpy) == pytest.approx(0, abs=1e-12)


def test_bending_ratio_goes_with_the_square() -> None:
    """Energy is quadratic in the second differences, which are as the amplitude."""
    a, b = (sheet(z=size * np.sin(np.pi * U / 0.6)) for size in (0.03, 0.01))
    assert detail.bending_ratio(GRID, a, b) == pytest.approx(9)
    assert np.isnan(detail.bending_ratio(GRID, a, sheet(0.0, 0.0, 0.0))).all()


def test_spectrum_above_the_coarse_nyquist() -> None:
    """12 x 8 cells: factor 2 keeps 6 half waves along the width. A cosine's mean square is its amplitude^2 / 2.

    Even waves: odd ones tilt the best plane.
    """

    def wave(k: int, size: float) -> np.ndarray:
        return size * np.cos(np.pi * k * (np.indices(GRID.shape)[1] + 0.5) / GRID.cols)

    kept, lost = sheet(z=wave(6, 0.02)), sheet(z=wave(6, 0.02) + wave(8, 0.01))
    assert detail.fine_detail(GRID, kept, 2) == pytest.approx(0, abs=1e-12)
    assert detail.fine_detail(GRID, lost, 2) == pytest.approx(0.01 / np.sqrt(2))
    assert detail.fine_detail(GRID, lost, 1.5) == pytest.approx(0, abs=1e-12)
    half = sheet(z=wave(6, 0.02) + wave(8, 0.005))
    assert detail.detail_ratio(GRID, half, lost, 2) == pytest.approx(0.5)
    assert np.isnan(detail.detail_ratio(GRID, half, 0 * FLAT, 2)).all()
    with pytest.raises(ValueError, match="tube"):
        detail.fine_detail(replace(GRID, periodic=True), FLAT, 2)
    assert np.isnan(detail.detail_ratio(replace(GRID, periodic=True), FLAT, FLAT, 2)).all()


BALL = Scene("Ball", GRID, Material(), 0.02, colliders=(Collider("sphere", 0.25),))


def ball(x: float, positions: np.ndarray = FLAT) -> State:
    return State.still(positions.copy(), np.full((1, 1, 2, 3), [x, 0.4, 0.0]))


def test_vertices_inside_a_ball() -> None:
    """Around a vertex at 0.1 m: 1 at depth .25, 4 at .15, 4 at .25 - .1 sqrt 2, 4 at .05, 8 at .25 - .1 sqrt 5."""
    found = contact.inside(BALL, ball(0.6))
    assert found.count == 21
    assert found.max == pytest.approx(0.25)
    depth = 0.25 + 4 * 0.15 + 4 * (0.25 - 0.1 * 2**0.5) + 4 * 0.05 + 8 * (0.25 - 0.1 * 5**0.5)
    assert found.mean == pytest.approx(depth / 21)


def test_tunnelling_is_counted_and_grazing_is_not() -> None:
    """A ball that jumps from above to below the sheet passes all vertices within half its radius."""
    above, below = ball(0.6), ball(0.6)
    above.colliders[..., 2], below.colliders[..., 2] = 0.4, -0.4
    assert contact.tunnelled(BALL, [above, below]) == 5  # the vertex at its middle and four 0.1 m away; 0.141 is out
    assert contact.tunnelled(BALL, [below, above, below]) == 10
    beside, far = ball(0.6), ball(0.6)
    beside.colliders[..., 2], far.colliders[..., 2] = 0.4, 0.3  # never reaches the sheet
    assert contact.tunnelled(BALL, [beside, far]) == 0
    floor = replace(BALL, colliders=(Collider("plane"),))
    up = np.array([[[[0, 0, 0], [0, 0, 1.0]]]])
    high, low = (State.still(FLAT + np.array([0, 0, z])[:, None, None], up) for z in (0.01, -0.01))
    assert contact.tunnelled(floor, [high, low]) == GRID.vertices
    assert contact.tunnelled(floor, [low, high]) == 0


def test_all_metrics_of_two_trajectories() -> None:
    scene = replace(BALL, colliders=())
    rng = np.random.default_rng(0)
    run, truth = ([State.still(FLAT + 0.01 * rng.normal(size=FLAT.shape)) for _ in range(4)] for _ in range(2))
    same, other = (metrics.at_frame(scene, state, truth[2], span=1.0) for state in (truth[2], run[2]))
    assert (same["error_max"], same["inside"]) == (0, 0)
    assert same["bending_ratio"] == pytest.approx(1)
    assert other["max_dx"] == errors.largest(run[2].positions, truth[2].positions) > 0
    whole = metrics.over_frames(scene, run, truth)
    x, y = (np.stack([s.positions for s in states]) for states in (run, truth))
    assert whole["flicker"] == pytest.approx(errors.flicker(x, y, scene.frame_dt).mean(0))
    assert whole["tunnelled"] == 0


def test_folds_are_told_by_their_fineness() -> None:
    """A cosine along rows has its power in one band, as the square of its height; a turn changes nothing."""
    grid = Grid(5, 35, 0.4, 3.4)  # 33 inner vertices
    u = np.arange(35.0)

    def waves(height: float) -> np.ndarray:
        z = height * np.cos(np.pi * 12 * (u - 0.5) / 33)  # of the inner vertices mode 12 of the cosine transform
        return np.stack(np.broadcast_arrays(0.1 * u, 0.1 * np.arange(5.0)[:, None], z))[None]

    power = spectra.in_space(grid, waves(0.01))[0]
    band = 12 * spectra.BANDS // 33
    assert power.argmax() == band
    assert np.delete(power, band) == pytest.approx(0, abs=1e-9 * power[band])
    assert spectra.in_space(grid, waves(0.02))[0, band] == pytest.approx(4 * power[band])
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    turned = np.einsum("ij,bjhw->bihw", turn, waves(0.01))
    assert spectra.in_space(grid, turned)[0] == pytest.approx(power, abs=1e-9 * power[band])
    # Around a tube of 32 vertices 8 waves are half the Nyquist limit.
    tube, angle = Grid(5, 32, 0.4, 3.2, periodic=True), 2 * np.pi * np.arange(32) / 32
    bumps = 0.001 * np.cos(8 * angle)
    x = np.stack(np.broadcast_arrays(0.5 * np.cos(angle), np.arange(5.0)[:, None], 0.5 * np.sin(angle)))[None]
    rough = x + np.stack(np.broadcast_arrays(0.0, bumps, np.zeros((5, 1))))[None]
    more = (spectra.in_space(tube, rough) - spectra.in_space(tube, x))[0]
    assert more.argmax() == spectra.BANDS // 2 - 1
    with pytest.raises(ValueError, match="32 columns"):
        spectra.in_space(GRID, FLAT)


def test_motion_is_told_by_its_frequency() -> None:
    dt = 0.02
    time = np.arange(161) * dt
    band = 4
    hertz = (band + 1) / (2 * spectra.BANDS * dt)
    x = np.zeros((161, 2, 3, 2, 2))
    x[:, 1, 2] = 0.1 * np.sin(2 * np.pi * hertz * time)[:, None, None]
    power = spectra.in_time(x, dt)
    assert power.shape == (spectra.BANDS, 2)
    assert power[:, 1].argmax() == band
    assert not power[:, 0].any()
    # Half the square of the velocity's amplitude, which differences of frames make less by sin(a)/a, a = pi f dt.
    a = np.pi * hertz * dt
    whole = (0.1 * 2 * np.pi * hertz * np.sin(a) / a) ** 2 / 2
    assert power[:, 1].sum() / (2 * spectra.BANDS * dt) == pytest.approx(whole, rel=1e-3)
    with pytest.raises(ValueError, match="more than 32 frames"):
        spectra.in_time(x[:32], dt)
    assert spectra.apart(power[:, 1] * 10, power[:, 1]) == pytest.approx(10)
