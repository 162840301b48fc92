"""Laws of contact: friction on slopes and moving tables, and no tunnelling at any speed."""

from __future__ import annotations

import numpy as np
import pytest
from worlds import THREADS, G, centre, flat, run

from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.physics.explicit.solver import ExplicitSolver
from cloth_envs.scene import Air, Collider, Scene
from cloth_envs.state import Controls, State

MU = 0.5
CLOTH = Material(0.2, 500.0, 150.0, 1e-4, 5e-5, drag=0)
HUGE = 1e5  # m; a body so large that a small sheet lies on a plane


def on_slope(kind: str, angle: float) -> tuple[Scene, State, np.ndarray]:
    """A sheet of 0.1 m on top of a body that falls off by ``angle``, and the downhill direction."""
    grid = Grid(5, 5, 0.1, 0.1)
    downhill = np.array([np.cos(angle), 0, -np.sin(angle)])
    normal = np.array([np.sin(angle), 0, np.cos(angle)])
    scene = Scene("slope", grid, CLOTH, 0.02, colliders=(Collider(kind, 0 if kind == "plane" else HUGE, MU),))
    x = flat(
        grid, down=downhill, right=(0, 1, 0), origin=normal * scene.thickness - 0.05 * (downhill + np.array([0, 1, 0]))
    )
    axis = {"plane": np.array([0 * normal, normal]), "sphere": np.array([normal, normal]) * -HUGE}
    axis["capsule"] = axis["sphere"] + np.array([-10 * downhill, 10 * downhill])
    return scene, State.still(x, axis[kind][None, None]), downhill


@pytest.mark.parametrize("kind", ["plane", "sphere", "capsule"])
def test_a_sheet_rests_on_a_slope_below_the_angle_of_friction(kind: str) -> None:
    for angle in (np.arctan(MU) - 0.02, 0.2):
        scene, state, _ = on_slope(kind, angle)
        states, _ = run(scene, state, frames=25)
        # On a plane friction undoes every substep: only roundoff. A sheet first comes down on a round body,
        # from the height (0.05 m)^2 / R at its corners, and slips by less than that; and R is rounded.
        slack = 1e-12 if kind == "plane" else 0.05**2 / HUGE + 25 * HUGE * np.finfo(float).eps
        assert abs(states[-1].positions - state.positions).max() <= slack


@pytest.mark.parametrize("kind", ["plane", "sphere", "capsule"])
def test_a_sheet_slides_down_a_steeper_slope(kind: str) -> None:
    for angle in (np.arctan(MU) + 0.02, 0.9):
        scene, state, downhill = on_slope(kind, angle)
        states, _ = run(scene, state, frames=15)
        t = np.arange(16) * scene.frame_dt
        way = (centre(scene, states) - centre(scene, states)[0]) @ downhill
        law = G * (np.sin(angle) - MU * np.cos(angle))
        # Velocity Verlet is exact for a constant force. On round bodies the corners first fall (0.05 m)^2 / R
        # without friction, for a time sqrt(2 fall / (g cos)); the slope changes by the way over R.
        fall = (2 * 0.05**2 / HUGE / (G * np.cos(angle))) ** 0.5
        slack = 1e-10 if kind == "plane" else MU * G * fall * t[-1] + G * t[-1] ** 2 * (0.05 + way[-1]) / HUGE
        np.testing.assert_allclose(way, law * t * t / 2, atol=slack)


@pytest.mark.parametrize("pull", [0.8, 1.5])
def test_a_table_pulled_gently_takes_its_cloth_along(pull: float) -> None:
    grid = Grid(5, 5, 0.1, 0.1)
    scene = Scene("table", grid, CLOTH, 0.02, colliders=(Collider("plane", friction=MU),))
    table = np.array([[[[0, 0, 0], [0, 0, 1.0]]]])
    acceleration = pull * MU * G

    def drive(frame: int, state: State) -> Controls:
        t = (frame + 1) * scene.frame_dt
        controls = Controls.hold(state, ())
        controls.colliders[..., 0, 0] = acceleration * t * t / 2
        controls.collider_velocities[..., 0, 0] = acceleration * t
        return controls

    states, h = run(scene, State.still(flat(grid, origin=(0, 0, scene.thickness)), table), drive, 15)
    t = 15 * scene.frame_dt
    way = (centre(scene, states)[-1] - centre(scene, states)[0])[0]
    expected = min(acceleration, MU * G) * t * t / 2  # sticks, or slips at mu g
    assert way == pytest.approx(expected, abs=min(acceleration, MU * G) * t * h / 2 + 1e-10)
    assert (acceleration * t * t / 2 - way > 0.05) == (pull > 1)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_a_fast_sphere_does_not_pass_the_hung_cloth(dtype: str) -> None:
    grid, radius, speed = Grid(61, 41, 1.5, 1.0), 0.1, 20.0
    scene = Scene("hit", grid, CLOTH, 0.02, handles=(0, 40), colliders=(Collider("sphere", radius),))
    check_no_tunnelling(scene, speed, frames=3, dtype=dtype)


@pytest.mark.parametrize("speed", [30.0, 60.0])
def test_still_air_holds_a_cloth_that_a_ball_tears_along(speed: float) -> None:
    """A free sheet: its air is faster than any wind, and steps are counted for it alone, not for others of a batch."""
    grid, dt = Grid(25, 25, 1.0, 1.0), 0.02
    scene = Scene("shot", grid, Material(), dt, air=Air(), colliders=(Collider("sphere", 0.1, MU),))
    velocity = np.array([[[[0.0, 0.0, -speed]] * 2], [[[0.0, 0.0, 0.0]] * 2]])  # the second one's ball rests below
    place = np.array([[[[0.6, -0.4, 0.12 + speed * dt]] * 2], [[[0.5, -0.5, -3.0]] * 2]])
    state = State.still(np.repeat(flat(grid), 2, 0), place)
    state.collider_velocities[:] = velocity
    ends = []
    for members in ([0, 1], [1]):
        solver = ExplicitSolver(scene, num_envs=len(members))
        solver.reset(state.select(members))
        for frame in range(6):
            controls = Controls.hold(solver.state, ())
            controls.colliders = (place + velocity * dt * (frame + 1))[members]
            controls.collider_velocities = velocity[members]
            solver.advance(controls)
        assert solver.last_cuts[-1].tolist() == solver.cuts[-1].tolist()
        ends.append(solver.state.positions)
    assert np.isfinite(ends[0]).all()
    assert abs(ends[0][0] - flat(grid)[0]).max() > 0.3  # it was hit
    np.testing.assert_array_equal(ends[0][1], ends[1][0])


@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.4, 0.3)])
def test_a_small_fast_sphere_that_jumps_its_own_width_in_a_substep_is_seen(offset: tuple[float, float]) -> None:
    grid, radius, speed = Grid(21, 21, 0.5, 0.5), 0.03, 40.0
    border = np.ones(grid.shape, bool)
    border[1:-1, 1:-1] = False
    held = tuple(np.flatnonzero(border).tolist())
    limp = THREADS.with_changes(stretch_stiffness=10.0)
    scene = Scene("shot", grid, limp, 0.002, held, colliders=(Collider("sphere", radius),))
    h = check_no_tunnelling(scene, speed, frames=6, dtype="float64", offset=offset, watched=1)
    assert speed * h > 2 * radius


def check_no_tunnelling(
    scene: Scene,
    speed: float,
    *,
    frames: int,
    dtype: str,
    offset: tuple[float, float] = (0.0, 0.0),
    watched: int = 100,
) -> float:
    """Shoot the scene's sphere along y through the middle of a vertical sheet; the substep [s].

    Vertices in its way must be in front of it for ``watched`` frames; limp ones then slip off its sides.
    """
    grid, radius = scene.grid, scene.colliders[0].radius
    x = flat(grid, down=(0, 0, -1))
    aim = np.array([grid.width / 2 + offset[0] * grid.col_spacing, 0, -grid.height / 2 + offset[1] * grid.row_spacing])
    start = aim - [0, radius + 0.01, 0]
    velocity = np.array([0, speed, 0])

    def drive(frame: int, state: State) -> Controls:
        controls = Controls.hold(state, scene.handles)
        controls.colliders[:] = start + velocity * (frame + 1) * scene.frame_dt
        controls.collider_velocities[:] = velocity
        return controls

    state = State.still(x, np.full((1, 1, 2, 3), start))
    state.collider_velocities[:] = velocity
    states, h = run(scene, state, drive, frames, dtype=dtype)
    free = np.ones(grid.vertices, bool)
    free[list(scene.handles)] = False
    free = free.reshape(grid.shape)
    hit = np.hypot(x[0, 0] - aim[0], x[0, 2] - aim[2]) < radius / 2
    assert hit.sum() >= 1
    for frame, now in enumerate(states[1:]):
        apart = now.positions[0] - now.colliders[0, 0, 0][:, None, None]
        distance = np.linalg.norm(apart, axis=0)[free]
        # Contact ends each substep on or outside the tangent plane at radius + thickness.
        assert radius + scene.thickness - distance.min() <= 16 * np.finfo(dtype).eps * speed
        assert frame >= watched or (apart[1][hit] > 0).all()
    assert states[-1].colliders[0, 0, 0, 1] > 2 * radius  # it went through where the sheet was
    return h


@pytest.mark.parametrize("kind", ["plane", "sphere", "capsule"])
def test_a_draped_sheet_comes_to_rest_without_jitter(kind: str) -> None:
    grid, radius = Grid(21, 21, 0.6, 0.6), 0.0 if kind == "plane" else 0.15
    scene = Scene("drape", grid, CLOTH.with_changes(drag=10.0), 0.02, colliders=(Collider(kind, radius, MU),))
    ends = {
        "plane": [[0, 0, 0], [0, 0, 1.0]],
        "sphere": [[0, 0, -0.15]] * 2,
        "capsule": [[-0.2, 0, -0.15], [0.2, 0, -0.15]],
    }
    state = State.still(flat(grid, origin=(-0.3, 0.3, 0.01)), np.array([[ends[kind]]], float))
    states, h = run(scene, state, frames=400)
    # Still means rounding: positions of order 1 m over a substep, accumulated where friction holds.
    assert np.abs(states[-1].velocities).max() <= 16 * np.finfo(float).eps / h
    assert np.abs(states[-1].positions - states[-100].positions).max() <= 1e-9
    assert np.abs(states[-1].positions[0, 2] - state.positions[0, 2]).max() >= 0.004  # it did come down


def test_a_turning_capsule_sweeps_the_cloth_along() -> None:
    grid, radius, rate = Grid(31, 31, 0.6, 0.6), 0.03, 6.0  # rad/s about z
    scene = Scene("stir", grid, CLOTH, 0.02, colliders=(Collider("capsule", radius, MU),))
    start = np.array([[-0.25, 0.0, 0.0], [0.25, 0.0, 0.0]])

    def turned(t: float) -> np.ndarray:
        c, s = np.cos(rate * t), np.sin(rate * t)
        return start @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])

    def drive(frame: int, state: State) -> Controls:
        controls, end = Controls.hold(state, ()), turned((frame + 1) * scene.frame_dt)
        controls.colliders[:] = end
        controls.collider_velocities[:] = np.cross([0, 0, rate], end)
        return controls

    state = State.still(flat(grid, origin=(-0.3, 0.3, radius + scene.thickness)), start[None, None])
    state.collider_velocities[:] = np.cross([0, 0, rate], start)
    states, _ = run(scene, state, drive, 12)
    for now in states[1:]:
        axis = now.colliders[0, 0, 1] - now.colliders[0, 0, 0]
        apart = now.positions[0].reshape(3, -1).T - now.colliders[0, 0, 0]
        s = np.clip(apart @ axis / (axis @ axis), 0, 1)
        distance = np.linalg.norm(apart - s[:, None] * axis, axis=1)
        assert radius + scene.thickness - distance.min() < 1e-12
    x = state.positions[0]
    moved = (states[-1].positions[0] - x)[:2]
    spin = (x[0] * moved[1] - x[1] * moved[0])[np.hypot(x[0], x[1]) < 0.2].mean()
    assert spin > 1e-4  # m^2; friction takes the sheet on it round
