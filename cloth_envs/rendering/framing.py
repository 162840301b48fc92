"""Where things are in a picture: how the cloth is held, what it can reach, where the camera stands."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cloth_envs.grid import Grid
from cloth_envs.scene import Scene
from cloth_envs.state import State

VIEW_ANGLE = 28.0  # degrees, vertical
FILL = 0.90  # fraction of the picture that the scene may fill
SLACK = 0.25  # fraction of the cloth's size that handles or bodies may move before the camera follows
ARROW = 0.6  # of the cloth's size, length of the arrow of the fastest wind
TURN_ROUND = 0.6  # of a flag's length that is kept free around its pole
FLOOR_GAP = {"pole": 0.0, "rail": 0.03, "frame": 0.0, "belt": 0.25, "pins": 0.15, "free": 0.0}  # of the cloth's size
WORN_GAP = 0.07  # the same under a body that wears the cloth
HEADROOM = {"pole": 0.06, "rail": 0.05, "frame": 0.0, "belt": 0.0, "pins": 0.04, "free": 0.0}  # of the cloth's size
ELEVATION = {"pole": 9.0, "rail": 9.0, "frame": 24.0, "belt": 14.0, "pins": 14.0, "free": 24.0}  # degrees
TURN = {"pole": 24.0, "rail": 28.0, "frame": 30.0, "belt": 0.0, "pins": 32.0, "free": 30.0}  # degrees


@dataclass(frozen=True)
class Camera:
    """Where the camera stands, what it looks at [m] and which way is up."""

    position: tuple[float, float, float]
    focal_point: tuple[float, float, float]
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)

    @property
    def towards(self) -> np.ndarray:
        """From what it looks at to where it stands, ``(3,)`` [m]."""
        return np.subtract(self.position, self.focal_point)


def support(scene: Scene) -> str:
    """How the cloth is held: ``pole``, ``rail``, ``frame``, ``belt``, ``pins`` or ``free``."""
    grid, handles = scene.grid, np.array(scene.pins, int)
    if not len(handles):
        return "free"
    row, col = np.divmod(handles, grid.cols)
    if grid.periodic:
        return "belt" if (row == row[0]).all() and len(handles) == grid.cols else "pins"
    if (col == 0).all() and len(handles) == grid.rows:
        return "pole"
    if (row == 0).all() and len(handles) > 2:
        return "rail"
    return "frame" if np.isin(grid.border, handles).all() else "pins"


def at_resolution(scene: Scene, shape: tuple[int, int]) -> Scene:
    """The scene on a grid of another ``(rows, cols)``: the same pins at the nearest vertices, of grips no more."""
    grid = scene.grid
    if shape == grid.shape:
        return scene
    fine = replace(grid, rows=shape[0], cols=shape[1])
    row, col = np.divmod(np.array(scene.pins, int), grid.cols)
    row = np.rint(row * (fine.rows - 1) / (grid.rows - 1)).astype(int)
    col = np.rint(col * fine.cells[1] / grid.cells[1]).astype(int)
    vertices = row * fine.cols + col % fine.cols
    kind, (down, across) = support(scene), np.indices(fine.shape)
    if kind in ("pole", "belt"):  # whole lines of vertices stay whole
        vertices = np.flatnonzero(across == 0 if kind == "pole" else down == row[0])
    elif kind == "frame":
        vertices = np.sort(fine.border)
    return replace(scene, grid=fine, handles=tuple(dict.fromkeys(vertices.tolist())), grips=())


def lowest_hang(grid: Grid, handles: Sequence[int], heights: np.ndarray) -> float:
    """Height [m] that no vertex can sink below: ``min_v max_h (z_h - |v - h|)`` over the flat sheet."""
    row, col = np.divmod(np.array(handles, int), grid.cols)
    rows = np.linspace(0, grid.rows - 1, min(grid.rows, 17))
    cols = np.linspace(0, grid.cols - 1, min(grid.cols, 17))
    across = np.abs(cols[:, None] - col)
    if grid.periodic:
        across = np.minimum(across, grid.cols - across)
    down = (rows[:, None] - row) * grid.row_spacing
    length = np.hypot(down[:, None], across[None] * grid.col_spacing)  # (17, 17, N)
    return float((heights - length).max(-1).min())


def reach(scene: Scene, state: State, member: int = 0) -> np.ndarray:
    """Box ``(2, 3)`` [m], low and high corner, of what one member's cloth and bodies may occupy."""
    grid, kind = scene.grid, support(scene)
    points = state.positions[member].reshape(3, -1).T.astype(float)
    low, high = points.min(0), points.max(0)
    if kind == "frame":
        rise = 0.28 * min(grid.width, grid.height)
        low[2], high[2] = low[2] - rise, high[2] + rise  # it may bulge either way
    elif kind != "free":
        handles = points[list(scene.pins)]
        low[2] = min(low[2], lowest_hang(grid, scene.pins, handles[:, 2]))
        if kind == "pole":  # the wind may turn, or the pole be walked about
            foot = handles.mean(0)
            low[:2] = np.minimum(low, foot - TURN_ROUND * grid.width)[:2]
            high[:2] = np.maximum(high, foot + TURN_ROUND * grid.width)[:2]
        if kind == "rail":
            along = np.abs(handles[-1] - handles[0])
            half = along / max(float(np.linalg.norm(along)), 1e-9) * grid.width / 2  # drawn open
            middle = (low + high) / 2
            low[:2], high[:2] = np.minimum(low, middle - half)[:2], np.maximum(high, middle + half)[:2]
            over = 2 * handles.mean(0) - np.stack([high, low])  # it may swing to the other side
            low[:2], high[:2] = np.minimum(low, over[0])[:2], np.maximum(high, over[1])[:2]
    for body, ends in zip(scene.colliders, state.colliders[member].astype(float), strict=True):
        if body.kind != "plane":
            low, high = np.minimum(low, ends.min(0) - body.radius), np.maximum(high, ends.max(0) + body.radius)
            if kind == "free":  # it may hang over the body by half its diagonal
                low[2] = min(low[2], ends[:, 2].max() + body.radius - np.hypot(grid.width, grid.height) / 2)
            if kind == "rail":  # it may press the hem
                low[2] = min(low[2], lowest_hang(grid, scene.pins, handles[:, 2]) - body.radius)
    size = max(grid.width, grid.height)
    gap = WORN_GAP if kind == "belt" and scene.colliders else FLOOR_GAP[kind]
    low[2], high[2] = low[2] - gap * size, high[2] + HEADROOM[kind] * size
    for body, (point, normal) in zip(scene.colliders, state.colliders[member], strict=True):
        if body.kind == "plane" and normal[2] > 0.99 * np.linalg.norm(normal):
            low[2] = point[2]  # the first level one is the ground
            break
    return np.stack([low, high])


def direction(scene: Scene, state: State, member: int = 0) -> np.ndarray:
    """Unit vector from the scene to the camera: a three-quarter view of the side that faces -y."""
    kind, grid = support(scene), state.positions[member].astype(float)
    area = np.cross(np.diff(grid, axis=1)[:, :, :-1], np.diff(grid, axis=2)[:, :-1], axis=0).sum((1, 2))
    level = np.hypot(area[0], area[1])
    azimuth = np.deg2rad(-90.0)
    if level > abs(area[2]) and kind != "belt":
        azimuth = np.arctan2(area[1], area[0])
        if np.sin(azimuth) > 1e-6 or (abs(np.sin(azimuth)) <= 1e-6 and np.cos(azimuth) < 0):
            azimuth += np.pi
    azimuth += np.deg2rad(TURN[kind])
    up = np.deg2rad(ELEVATION[kind] if level > abs(area[2]) or kind == "belt" else max(ELEVATION[kind], 24.0))
    return np.array([np.cos(azimuth) * np.cos(up), np.sin(azimuth) * np.cos(up), np.sin(up)])


def anchor(scene: Scene, state: State, member: int) -> np.ndarray:
    """What the camera follows, ``(3,)`` [m]: the mean of the handles, else of the bodies, else the origin."""
    if scene.pins:
        return state.positions[member].reshape(3, -1)[:, list(scene.pins)].mean(1).astype(float)
    bodies = [ends.mean(0) for body, ends in zip(scene.colliders, state.colliders[member], strict=True) if body.radius]
    return np.mean(bodies, 0).astype(float) if bodies else np.zeros(3)


def arrow_length(scene: Scene, speed: float) -> float:
    """Length [m] of the arrow of a wind [m/s]: as the root of its speed; ``scene`` is windy."""
    assert scene.air is not None
    longest = ARROW * max(scene.grid.width, scene.grid.height)
    return float(longest * min(np.sqrt(speed / scene.air.max_wind), 1.0))


def together(
    scenes: Sequence[Scene], states: Sequence[State], member: int, aspect: float, below: float
) -> tuple[np.ndarray, Camera]:
    """What all of them may occupy, ``(2, 3)`` [m] as in ``reach``, and the camera that shows it; see ``fit``."""
    boxes = np.stack([reach(scene, state, member) for scene, state in zip(scenes, states, strict=True)])
    box = np.stack([boxes[:, 0].min(0), boxes[:, 1].max(0)])
    corners = np.array(np.meshgrid(*box.T)).reshape(3, -1).T
    return box, fit(corners, direction(scenes[0], states[0], member), aspect, below)


def fit(points: np.ndarray, towards: np.ndarray, aspect: float, below: float = 0.0) -> Camera:
    """The camera that just holds ``points`` ``(N, 3)``, z up.

    With x right, y up and z towards the camera at distance D, a point is inside the right edge when
    ``x - cx <= (D - z) t``; the two edges of an axis give D and the centre cx in closed form. ``below``
    is the fraction of the picture's height kept free at its lower edge.
    """
    right = np.cross([0.0, 0.0, 1.0], towards)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(towards, right), towards])
    x = points @ axes.T
    half = np.tan(np.deg2rad(VIEW_ANGLE / 2)) * FILL
    tangents = np.array([half * aspect, half * (1 - below)])
    most = (x[:, :2] + x[:, 2:] * tangents).max(0)
    least = (-x[:, :2] + x[:, 2:] * tangents).max(0)
    distance = float(((most + least) / (2 * tangents)).max())
    centre = np.append((most - least) / 2, 0.0)
    centre[1] -= below * half * distance
    focal = centre @ axes
    return Camera(tuple(focal + distance * axes[2]), tuple(focal), tuple(axes[1]))
