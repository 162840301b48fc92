"""The cloth in a picture: its mesh, normals and strain, all from the ``(3, H, W)`` positions."""

from typing import Any

import numpy as np

from cloth_envs.grid import Grid
from cloth_envs.rendering import look


def drawn(values: np.ndarray, periodic: bool) -> np.ndarray:
    """``(..., H, W)`` with the first column repeated at the end when the sheet is a tube."""
    return np.concatenate([values, values[..., :1]], -1) if periodic else values


def normals(positions: np.ndarray, periodic: bool) -> np.ndarray:
    """Unit vertex normals ``(3, H, W)`` of ``positions`` ``(3, H, W)`` [m] from central differences."""
    beyond = int(periodic)
    wide = np.pad(positions, ((0, 0), (0, 0), (beyond, beyond)), mode="wrap")
    down, across = (d[..., beyond : d.shape[2] - beyond] for d in np.gradient(wide, axis=(1, 2)))
    normal = np.cross(down, across, axis=0)
    return normal / np.maximum(np.linalg.norm(normal, axis=0), 1e-12)


def vertex_strain(positions: np.ndarray, grid: Grid) -> np.ndarray:
    """Structural strain ``(H, W)`` of ``positions`` ``(3, H, W)`` [m], positive when stretched.

    The strain of an edge is ``length / rest_length - 1``. A vertex takes the mean of its edges along
    its row and the mean along its column, whichever is larger in size.
    """
    means = []
    for axis, rest in ((0, grid.row_spacing), (1, grid.col_spacing)):
        wrap = grid.periodic and axis == 1
        edge = np.linalg.norm(np.diff(drawn(positions, wrap), axis=axis + 1), axis=0) / rest - 1
        beyond = [(0, 0), (0, 0)]
        beyond[axis] = (1, 0) if wrap else (1, 1)
        edge = np.pad(edge, beyond, mode="wrap" if wrap else "edge")
        means.append((edge[:-1] + edge[1:]) / 2 if axis == 0 else (edge[:, :-1] + edge[:, 1:]) / 2)
    return np.where(np.abs(means[0]) >= np.abs(means[1]), *means)


class Sheet:
    """The mesh of a cloth on ``grid`` in ``plotter``, woven, or coloured by strain within ``+-strain_range``."""

    def __init__(self, pv: Any, plotter: Any, grid: Grid, strain_range: float | None) -> None:
        self.grid, self.strained = grid, strain_range is not None
        flat = Grid(grid.rows, grid.cells[1] + 1, grid.height, grid.width)
        self.mesh = pv.PolyData.from_regular_faces(np.zeros((flat.vertices, 3), np.float32), flat.triangles)
        self.mesh.point_data.active_normals = np.zeros((flat.vertices, 3), np.float32)
        if strain_range is not None:
            self.mesh.point_data["strain"] = np.zeros(flat.vertices, np.float32)
            options: dict[str, Any] = {**look.STRAIN, "clim": (-100 * strain_range, 100 * strain_range)}
        else:
            self.mesh.active_texture_coordinates = weave_coordinates(flat, whole=grid.periodic)
            texture = pv.Texture(look.weave())
            texture.repeat, texture.interpolate = True, True
            back = {**look.CLOTH, "color": look.CLOTH_BACK, "interpolation": "Phong"}
            options = {"texture": texture, "color": look.CLOTH_FRONT, "backface_params": back}
        self.actor = plotter.add_mesh(self.mesh, **{**look.CLOTH, **options})
        self.actor.prop.interpolation = "Phong"  # smooth_shading=True would copy the mesh

    def move(self, positions: np.ndarray) -> None:
        """Show ``positions`` ``(3, H, W)`` [m]."""
        periodic = self.grid.periodic
        self.mesh.points = np.ascontiguousarray(drawn(positions, periodic).reshape(3, -1).T)
        normal = drawn(normals(positions, periodic), periodic).reshape(3, -1).T
        self.mesh.point_data.active_normals = np.ascontiguousarray(normal)
        if self.strained:
            self.mesh.point_data["strain"][:] = 100 * drawn(vertex_strain(positions, self.grid), periodic).ravel()


def weave_coordinates(grid: Grid, *, whole: bool) -> np.ndarray:
    """Texture coordinates ``(vertices, 2)`` in repeats of the weave; with ``whole`` it closes around a tube."""
    across = np.linspace(0, grid.width / look.WEAVE_SIZE, grid.cols)
    if whole:
        across *= np.rint(across[-1]) / across[-1]
    u, v = np.meshgrid(across, np.linspace(0, grid.height / look.WEAVE_SIZE, grid.rows))
    return np.stack([u.ravel(), v.ravel()], 1).astype(np.float32)
