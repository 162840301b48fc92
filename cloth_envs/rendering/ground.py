"""The floor: seen by thin lines and the soft shadow that falls on it."""

from typing import Any

import numpy as np
from PIL import Image, ImageFilter

from cloth_envs.rendering import look

CELLS = 160  # along a side of the shadow's image
TILE = 0.5  # m between lines
LINE = (176, 190, 202)  # their colour
DARKEST = 100  # opacity of the deepest shadow, of 255


def refined(positions: np.ndarray, least: int = 5_000) -> np.ndarray:
    """Points ``(N, 3)``, at least about ``least`` of them, spread over a sheet ``(3, H, W)``."""
    while positions[0].size < least:
        wide = np.empty((3, 2 * positions.shape[1] - 1, positions.shape[2]), positions.dtype)
        wide[:, ::2], wide[:, 1::2] = positions, (positions[:, 1:] + positions[:, :-1]) / 2
        positions = np.empty((*wide.shape[:2], 2 * wide.shape[2] - 1), wide.dtype)
        positions[..., ::2], positions[..., 1::2] = wide, (wide[..., 1:] + wide[..., :-1]) / 2
    return positions.reshape(3, -1).T


class Ground:
    """A level square under ``box`` ``(2, 3)`` [m], lit from the left of a camera in direction ``view``.

    Points fall along the light onto cells of the square, are counted, and blurred by a Gaussian that
    widens with their height.
    """

    def __init__(self, pv: Any, plotter: Any, box: np.ndarray, view: np.ndarray) -> None:
        self.pv = pv
        self.plane, self.lines, self.floor = pv.PolyData(), pv.PolyData(), pv.PolyData()
        self.lay(box, view)
        self.image = pv.ImageData(dimensions=(CELLS, CELLS, 1))
        self.image.point_data["rgba"] = np.zeros((CELLS * CELLS, 4), np.uint8)
        self.image.set_active_scalars("rgba")
        texture = pv.Texture(self.image)
        texture.interpolate = True
        self.actor = plotter.add_mesh(self.plane, texture=texture, lighting=False)
        self.tiles = plotter.add_mesh(self.lines, scalars="rgba", rgb=True, lighting=False, line_width=1.2)
        self.solid = plotter.add_mesh(self.floor, color=look.FLOOR)
        self.solid.visibility = False

    def lay(self, box: np.ndarray, view: np.ndarray) -> None:
        """Put it under another box, lit for another camera."""
        self.height = float(box[0, 2])
        extent = float(np.linalg.norm((box[1] - box[0])[:2]) + (box[1] - box[0])[2])
        self.side = 2.2 * extent
        centre = box.mean(0)
        self.low = centre[:2] - self.side / 2
        right, towards, _ = look.level_axes(view)
        self.fall = look.SHADOW_TILT * (0.8 * right - 0.6 * towards)[:2]
        at = (*centre[:2], self.height)
        self.plane.copy_from(self._square(at, self.side, 1))
        self.floor.copy_from(self._square(at, 10 * extent, 1))
        radius = 3.0 * extent  # at which the lines have faded out
        count = 2 * int(np.ceil(radius / TILE))
        lines = self._square((*(np.rint(centre[:2] / TILE) * TILE), self.height), count * TILE, count)
        lines = lines.extract_all_edges()
        away = np.linalg.norm(lines.points - at, axis=1) / radius
        rgba = np.empty((lines.n_points, 4), np.uint8)
        rgba[:, :3], rgba[:, 3] = LINE, 255 * np.clip(1 - away, 0, 1) ** 2
        lines.point_data["rgba"] = rgba
        self.lines.copy_from(lines)

    def _square(self, centre: tuple[float, float, float], side: float, cells: int) -> Any:
        return self.pv.Plane(center=centre, i_size=side, j_size=side, i_resolution=cells, j_resolution=cells)

    def cast(self, points: np.ndarray, along: np.ndarray) -> None:
        """Show the shadow of ``points`` ``(N, 3)`` [m] on the square moved by ``along`` ``(3,)`` [m]."""
        self.actor.position = (along[0], along[1], 0.0)
        low = self.low + along[:2]
        height = points[:, 2] - self.height
        cell = ((points[:, :2] + height[:, None] * self.fall - low) * (CELLS / self.side)).astype(int)
        cell = cell[((cell >= 0) & (cell < CELLS)).all(1)]
        count = np.bincount(cell[:, 1] * CELLS + cell[:, 0], minlength=CELLS**2)
        cover = Image.fromarray((np.minimum(count, 2) * (DARKEST / 2)).astype(np.uint8).reshape(CELLS, CELLS))
        spread = 0.02 + 0.08 * float(np.clip(np.median(height), 0, 1.5))  # m
        soft = cover.filter(ImageFilter.GaussianBlur(spread * CELLS / self.side))
        self.image.point_data["rgba"][:, 3] = np.asarray(soft).ravel()
        self.image.Modified()
