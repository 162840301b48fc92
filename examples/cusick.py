"""A Cusick drape test (BS 5058): a disc of 30 cm on a pedestal of 18 cm, its shadow over the ring, and its folds.

``python examples/cusick.py [vertices a side] [fabric ...]``. A disc is no rectangle of vertices: the torch cell steps a
square of 30 cm whose masses and stiffnesses count in cells inside the disc only; what lies outside falls away. The
middle 18 cm are held flat: there is no slipping on the pedestal, nor a cover plate that presses.
"""

import sys

import numpy as np
import torch
from PIL import Image, ImageDraw
from scipy.signal import find_peaks

from cloth_envs.folds import bending_length
from cloth_envs.grid import Grid
from cloth_envs.material import FABRICS
from cloth_envs.physics.explicit.bounds import stable_step
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from surrogates.cell.frame import frame
from surrogates.cell.sheet import SheetCell, properties

DISC, PEDESTAL, PIXEL = 0.15, 0.09, 5e-4  # m: radii, side of a pixel of the shadow


def disc(scene):
    """The cell of a sheet that is cut along the cells whose middle lies in the disc, and those cells."""
    grid, cell = scene.grid, SheetCell(scene)
    r, c = ((np.arange(n) + 0.5) * 2 * DISC / n - DISC for n in grid.cells)
    padded = np.pad((np.hypot(r[:, None], c) < DISC).astype(float), 1)  # with an empty rim
    along, down = (padded[:-1] + padded[1:])[:, 1:-1] / 2, (padded[:, :-1] + padded[:, 1:])[1:-1] / 2  # of edges
    inner, both = padded[1:-1, 1:-1], (np.minimum(along[:, :-1], along[:, 1:]), np.minimum(down[:-1], down[1:]))
    for k, part in enumerate((along, down, inner, inner, *both, inner)):  # springs, then bending
        share = getattr(cell, f"share{k}")
        share.copy_(share.max() * torch.as_tensor(part))
    area = (padded[:-1, :-1] + padded[1:, :-1] + padded[:-1, 1:] + padded[1:, 1:]) / 4
    cell.areas.copy_(torch.as_tensor(np.where(area > 0, area, 1.0) * grid.row_spacing * grid.col_spacing))
    return cell, inner > 0


def drape(fabric, size=25, seconds=0.8, seed=0):
    """Drape coefficient [%], number of folds, and the sheet with its cells, at rest."""
    material = FABRICS[fabric].with_changes(drag=25.0)
    grid = Grid(size, size, 2 * DISC, 2 * DISC)
    r, c = np.indices(grid.shape)
    x = np.stack([c * grid.col_spacing - DISC, DISC - r * grid.row_spacing, np.zeros(grid.shape)])
    away = np.hypot(*x[:2])
    scene = Scene("Cusick", grid, material, 0.02, handles=tuple(np.flatnonzero(away <= PEDESTAL).tolist()))
    cell, inside = disc(scene)
    x[2] = 1e-3 * (away > PEDESTAL) * np.random.default_rng(seed).normal(size=grid.shape)
    state = State.still(x[None])
    controls, sheets = Controls.hold(state, scene.handles), properties([material], cell.areas)
    substeps = int(1.3 * scene.frame_dt / stable_step(scene, material)) + 1  # quarters of a cell at the rim are light
    x, v = (torch.as_tensor(a).to(cell.areas) for a in (state.positions, state.velocities))
    with torch.no_grad():
        for _ in range(round(seconds / scene.frame_dt)):
            x, v = frame(cell, scene, sheets, x, v, state, controls, substeps, 4)
    x = x[0].numpy()
    picture = Image.new("1", (round(2.4 * DISC / PIXEL),) * 2)
    pen = ImageDraw.Draw(picture)
    for i, j in np.argwhere(inside):
        corners = x[:2, [i, i, i + 1, i + 1], [j, j + 1, j + 1, j]]
        pen.polygon([tuple(p) for p in ((corners + 1.2 * DISC) / PIXEL).T], fill=1)
    ring = np.sum(picture) * PIXEL**2 - np.pi * PEDESTAL**2
    rim = np.argwhere((away > DISC - grid.diagonal) & (away < DISC))
    rim = rim[np.argsort(np.arctan2(*(rim - (size - 1) / 2).T))]
    reach = np.hypot(*x[:2, rim[:, 0], rim[:, 1]]) / away[tuple(rim.T)]
    folds = len(find_peaks(np.tile(reach, 3), prominence=0.03)[0]) // 3
    return 100 * ring / (np.pi * (DISC**2 - PEDESTAL**2)), folds, x, inside


if __name__ == "__main__":
    size, names = int((sys.argv[1:] or ["25"])[0]), sys.argv[2:] or list(FABRICS)
    for name in names:
        coefficient, folds, *_ = drape(name, size)
        length = 100 * bending_length(FABRICS[name])
        print(f"{name:8s} bending length {length:.2f} cm  drape coefficient {coefficient:3.0f} %  folds {folds}")
