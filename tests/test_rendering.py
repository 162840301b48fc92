"""Pictures and depth images: they show the state, and only that."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from cloth_envs.grid import Grid
from cloth_envs.material import Material
from cloth_envs.rendering import Camera, Renderer, canvas, framing
from cloth_envs.rendering.sheet import normals, vertex_strain
from cloth_envs.scene import Air, Collider, Scene
from cloth_envs.state import State

SIZE = {"width": 160, "height": 120}


def sheet(rows=9, cols=13, *, height=1.0, width=1.5, level=False, amplitude=0.1):
    """A waving sheet ``(1, 3, rows, cols)``: hanging in the xz plane, or level at z = 1."""
    down, across = np.mgrid[0 : height : rows * 1j, 0 : width : cols * 1j]
    wave = amplitude * np.sin(6 * across)
    positions = [across, -down, 1 + wave] if level else [across, wave, 2 - down]
    return np.stack(positions)[None].astype(np.float32)


def make_scene(kind, rows=9, cols=13):
    """A scene and a state for every way to hold a cloth."""
    index = np.arange(rows * cols).reshape(rows, cols)
    border = np.concatenate([index[0], index[-1], index[:, 0], index[:, -1]])
    handles = {
        "pole": index[:, 0],
        "rail": index[0, ::4],
        "frame": np.unique(border),
        "belt": index[0],
        "pins": index[0, [0, -1]],
        "free": index[0, :0],
    }[kind]
    positions, colliders, bodies = sheet(rows, cols, level=kind in ("frame", "free")), (), None
    if kind == "belt":
        turn, down = np.meshgrid(2 * np.pi * np.arange(cols) / cols, np.linspace(0, 0.6, rows))
        radius = 0.2 + 0.3 * down
        positions = np.stack([radius * np.cos(turn), radius * np.sin(turn), 1 - down])[None].astype(np.float32)
        colliders = (Collider("capsule", 0.1),)
        bodies = np.array([[[[0, 0, 0.8], [0, 0, 1.2]]]])
    if kind == "free":
        colliders = (Collider("sphere", 0.2), Collider("plane"))
        bodies = np.array([[[[0.7, -0.5, 0.4]] * 2, [[0, 0, 0], [0, 0, 1]]]])
    grid = Grid(rows, cols, 0.6 if kind == "belt" else 1.0, 1.5, periodic=kind == "belt")
    air = Air(max_wind=12.0 if kind == "pole" else 0.0)
    scene = Scene(kind, grid, Material(), 0.04, tuple(handles.tolist()), air=air, colliders=colliders)
    return scene, State.still(positions, bodies)


@pytest.fixture
def flag():
    scene, state = make_scene("pole")
    state.wind[:] = [5.0, 1.0, 0.0]
    drawer = Renderer(scene, **SIZE)
    yield drawer, state
    drawer.close()


@pytest.mark.parametrize("kind", ["pole", "rail", "frame", "belt", "pins", "free"])
@pytest.mark.parametrize("color", ["fabric", "strain"])
def test_every_way_to_hold_a_cloth_is_drawn(kind, color):
    scene, state = make_scene(kind)
    assert framing.support(scene) == kind
    drawer = Renderer(scene, color=color, **SIZE)
    image = drawer.draw(state)
    assert image.shape == (120, 160, 3)
    assert image.dtype == np.uint8
    moved = state.copy()
    moved.positions[:, 1, 4:, 4:-2] -= 0.1
    assert (drawer.draw(moved) != image).any(-1).mean() > 0.005
    np.testing.assert_array_equal(drawer.draw(state), image)
    drawer.close()


def test_pictures_do_not_share_memory_and_the_state_is_untouched(flag):
    drawer, state = flag
    before = state.copy()
    first = drawer.draw(state)
    kept = first.copy()
    state.positions[:, 1] += 0.2
    drawer.draw(state)
    np.testing.assert_array_equal(first, kept)
    state.positions[:, 1] = before.positions[:, 1]
    for name, value in state.arrays().items():
        np.testing.assert_array_equal(value, before.arrays()[name])


def test_member_selects_one_cloth_of_a_batch(flag):
    drawer, state = flag
    both = state.select([0, 0])
    both.positions[1, 1, :, 6:] += 0.2
    np.testing.assert_array_equal(drawer.draw(both, member=1), drawer.draw(both.select([1])))
    assert (drawer.draw(both) != drawer.draw(both, member=1)).any()


def test_one_plotter_serves_every_picture(flag):
    drawer, state = flag
    drawer.draw(state)
    plotter, actors = drawer._canvas.plotter, len(drawer._canvas.plotter.actors)
    for _ in range(3):
        state.positions[:, 1] += 0.01
        drawer.draw(state)
        drawer.depth(state)
    assert drawer._canvas.plotter is plotter
    assert len(plotter.actors) == actors


def test_depth_is_where_rays_meet_the_sheet_and_the_ground():
    grid = Grid(9, 9, 1.0, 1.0)
    state = State.still(sheet(9, 9, width=1.0, level=True, amplitude=0.0))
    camera = Camera((0.5, -2.5, 3.0), (0.5, -0.5, 1.0))
    drawer = Renderer(Scene("Flat", grid, Material(), 0.02), camera=camera, **SIZE)
    depth = drawer.depth(state)
    near, ground = drawer._canvas.plotter.camera.clipping_range[0], drawer._canvas.views[0].ground.height
    np.testing.assert_array_equal(drawer.depth(state), depth)
    drawer.close()
    assert depth.shape == (120, 160)
    assert depth.dtype == np.float32
    # A pixel's ray, per metre along the axis of the camera.
    forward = np.subtract(camera.focal_point, camera.position) / np.sqrt(8)
    up = np.cross([1.0, 0.0, 0.0], forward)
    tangent = np.tan(np.deg2rad(framing.VIEW_ANGLE / 2))
    x = tangent * (2 * (np.arange(160) + 0.5) - 160) / 120
    y = tangent * (1 - 2 * (np.arange(120) + 0.5) / 120)
    ray = forward + x[None, :, None] * [1.0, 0.0, 0.0] + y[:, None, None] * up
    on_sheet, on_ground = ((height - camera.position[2]) / ray[..., 2] for height in (1.0, ground))
    hit = on_sheet[..., None] * ray + camera.position
    beside = np.abs(hit[..., :2] - [0.5, -0.5]).max(-1) - 0.5
    pixel = 2 * tangent * on_sheet.max() / 120 * np.sqrt(2)  # m on the sheet, seen at 45 degrees
    # A step of a 24-bit z-buffer is t^2 / near * 2^-24 metres; interpolating depth in float32 costs a few more.
    for inside, expected in ((beside < -pixel, on_sheet), (beside > pixel, on_ground)):
        assert inside.sum() > 500
        step = expected**2 / near * 2.0**-24
        assert (np.abs(depth - expected) / (4 * step))[inside].max() < 1


def test_depth_is_infinite_where_nothing_is():
    scene, state = make_scene("pole")
    drawer = Renderer(scene, camera=Camera((0.7, -5.0, 1.5), (0.7, 0.0, 1.5)), **SIZE)
    depth = drawer.depth(state)
    drawer.close()
    assert np.isinf(depth[0]).any()
    assert depth[60, 80] == pytest.approx(5.0, abs=0.1 + 1e-3)  # the wave's amplitude


def test_views_stand_side_by_side_at_any_resolution():
    scene, state = make_scene("pole")
    coarse = State.still(sheet(5, 7))
    drawer = Renderer(scene, views=2, captions=["fine", "coarse"], width=640, height=240)
    image = drawer.draw([state, coarse])
    assert image.shape == (240, 640, 3)
    left, right = image[:170, :320], image[:170, 320:]
    assert 0 < (np.abs(left.astype(int) - right).max(-1) > 40).mean() < 0.1
    assert (image[200:, :320] != image[200:, 320:]).any()
    same = drawer.draw([coarse.copy() if s is coarse else s for s in (state, coarse)])
    np.testing.assert_array_equal(image, same)
    with pytest.raises(ValueError, match="another Renderer"):
        drawer.draw([coarse, state])
    with pytest.raises(ValueError, match="1 states for 2 views"):
        drawer.draw(state)
    with pytest.raises(ValueError, match="views=1"):
        drawer.depth(state)
    drawer.close()


@pytest.mark.parametrize("kind", ["pole", "rail", "frame", "belt", "pins", "free"])
def test_handles_keep_their_place_at_another_resolution(kind):
    scene, _ = make_scene(kind)
    fine = framing.at_resolution(scene, (17, 26 if kind == "belt" else 25))
    assert framing.support(fine) == kind
    assert framing.at_resolution(fine, scene.grid.shape).handles == scene.handles


def test_the_camera_follows_handles_that_move_far():
    scene, state = make_scene("pole")
    slack = framing.SLACK * 1.5
    for camera, follows in ((None, True), (Camera((0.0, -5.0, 1.0), (0.0, 0.0, 1.0)), False)):
        drawer = Renderer(scene, camera=camera, **SIZE)
        drawer.draw(state)
        start = np.array(drawer._canvas.plotter.camera.position)
        for way in (0.5 * slack, 2.0):
            moved = state.copy()
            moved.positions[:, 0] += way
            drawer.draw(moved)
            expected = [max(0.0, way - slack) * follows, 0.0, 0.0]
            np.testing.assert_allclose(drawer._canvas.plotter.camera.position - start, expected, atol=1e-6)
        drawer.close()


def test_the_camera_just_holds_what_it_must():
    points = np.random.default_rng(0).normal(size=(50, 3))
    towards = np.array([0.3, -0.8, 0.4]) / np.linalg.norm([0.3, -0.8, 0.4])
    camera = framing.fit(points, towards, 1.5)
    position, focal, up = map(np.array, (camera.position, camera.focal_point, camera.up))
    right = np.cross(up, towards)
    away = (position - points) @ towards
    half = np.tan(np.deg2rad(framing.VIEW_ANGLE / 2)) * framing.FILL
    across = np.abs((points - position) @ right / away / half / 1.5).max()
    upwards = np.abs((points - position) @ up / away / half).max()
    assert max(across, upwards) == pytest.approx(1.0)
    np.testing.assert_allclose(np.cross(position - focal, towards), 0, atol=1e-9)


def test_the_lowest_a_cloth_hangs_is_its_distance_from_the_handles():
    grid = Grid(9, 9, 1.0, 1.0)
    assert framing.lowest_hang(grid, [0], np.array([2.0])) == pytest.approx(2 - np.sqrt(2))
    assert framing.lowest_hang(grid, [0, 8], np.array([2.0, 2.0])) == pytest.approx(2 - np.sqrt(1 + 0.25))
    assert framing.lowest_hang(grid, list(range(9)), np.full(9, 2.0)) == pytest.approx(1.0)


def test_strain_is_that_of_a_uniform_stretch():
    grid = Grid(9, 13, 1.0, 1.5)
    rest = sheet(amplitude=0.0)[0].astype(float)
    np.testing.assert_allclose(vertex_strain(rest, grid), 0, atol=1e-6)
    np.testing.assert_allclose(vertex_strain(rest * [[[1.02]], [[1]], [[0.95]]], grid), -0.05, atol=1e-6)
    scene, state = make_scene("belt")
    ring = 2 * 0.2 * np.sin(np.pi / 13) / scene.grid.col_spacing - 1  # chords of the waist, larger in size
    np.testing.assert_allclose(vertex_strain(state.positions[0], scene.grid)[0], ring, rtol=1e-5)


def test_normals_face_the_viewer_of_the_triangles():
    flat = sheet(amplitude=0.0)[0]
    a, b, c = (flat.reshape(3, -1)[:, i] for i in Grid(9, 13, 1.0, 1.5).triangles[0])
    facing = np.cross(b - a, c - a)
    np.testing.assert_allclose(
        normals(flat, False), np.broadcast_to((facing / np.linalg.norm(facing))[:, None, None], flat.shape), atol=1e-6
    )


def test_close_twice_then_draw_again(flag):
    drawer, state = flag
    drawer.close()
    image = drawer.draw(state)
    drawer.close()
    drawer.close()
    np.testing.assert_array_equal(drawer.draw(state), image)


def test_bad_input_is_refused(flag):
    drawer, state = flag
    state.positions[0, 2, 3, 4] = np.nan
    with pytest.raises(ValueError, match="last finite state"):
        drawer.draw(state)
    with pytest.raises(ValueError, match="2 states for 1 views"):
        drawer.draw([state, state])
    for options in ({"color": "red"}, {"views": 0}, {"captions": ["a", "b"]}, {"strain_range": 0}, {"height": 1}):
        with pytest.raises(ValueError, match=r"must be|fit|captions"):
            Renderer(drawer.scene, **options)


def test_a_missing_library_says_what_to_install(flag, monkeypatch):
    drawer, state = flag
    monkeypatch.setattr(canvas, "find_library", lambda name: None)
    with pytest.raises(ImportError, match="apt-get install libegl1"):
        canvas.check_window("vtkOSOpenGLRenderWindow")
    monkeypatch.setitem(sys.modules, "pyvista", None)
    with pytest.raises(ImportError, match=r'pip install -e "\.\[render\]"'):
        drawer.draw(state)


def test_importing_the_package_imports_no_pyvista():
    code = "import sys, cloth_envs, cloth_envs.rendering; sys.exit(bool({'pyvista', 'vtkmodules'} & set(sys.modules)))"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_no_arrow_is_drawn_in_still_air():
    images = []
    for air in (None, Air(), Air(max_wind=12.0)):
        scene, state = make_scene("rail")
        state.wind[:] = [5.0, 1.0, 0.0]
        drawer = Renderer(replace(scene, air=air), **SIZE)
        images.append(drawer.draw(state))
        drawer.close()
    assert (images[0] == images[1]).all()
    assert (images[1] != images[2]).any()
