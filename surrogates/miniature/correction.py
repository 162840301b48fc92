"""A learned correction of the coarse dynamics: after every frame each vertex is moved, and its velocity changed.

Every vertex reads what lies 1, 2 and 4 vertices away in its own axes: positions, velocities, what the frame changed of
these, gravity, wind, and how far border, handles and bodies are. A network of two hidden layers answers with a shift
and a change of velocity in the same axes. Turning the scene about the vertical turns the answer. Both are
bounded, and fade out around handles, so that a cloth unlike those of training is not torn.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from _minicloth_kernels import Correct

from cloth_envs.scene import Scene
from cloth_envs.state import State
from surrogates.checkpoint import of_factor

AROUND = np.array([(0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)])
# Vertices whose difference to a vertex it reads, (rows, columns) away: of positions, velocities and their change.
POSITIONS = np.concatenate([AROUND, 2 * AROUND, 4 * AROUND])
VELOCITIES = np.concatenate([AROUND[:4], 2 * AROUND, 4 * AROUND])
CHANGES = 2 * AROUND[:4]
REACHES = (1.5, 6.0)  # vertices over which the border is felt
HANDLE_REACHES = (2.0, 8.0)
FADE = 2.0  # vertices around handles
FAR = 6.0  # coarse spacings beyond which a body is not seen
LAYERS = 3
ARRAYS = (*(f"{kind}{k}" for k in range(LAYERS) for kind in ("weight", "bias")), "low", "high", "limit")


class Correction:
    """The network of one scene and factor.

    Args:
        coarse: the scene on the coarse grid.
        arrays: ``weight0`` ``(hidden, features)``, ``bias0``, ``weight1``, ``bias1``, ``weight2`` ``(6, hidden)``,
            ``bias2``; ``low`` and ``high`` ``(features,)``, to which features are clipped; ``limit`` ``(6,)`` of the
            answers, in coarse spacings, and in those per frame.

    Raises:
        ValueError: a tube.
    """

    def __init__(self, coarse: Scene, arrays: Mapping[str, np.ndarray]) -> None:
        grid = coarse.grid
        if grid.periodic:
            raise ValueError('correction="learned" has no tubes: leave it out')
        self.scene, self.arrays = coarse, dict(arrays)
        self._unit, self._dt = np.float32(grid.row_spacing), np.float32(coarse.frame_dt)
        self.share = _share(coarse)
        self._at = [_neighbours(coarse, away) for away in (POSITIONS, VELOCITIES, CHANGES)]
        self._nearer = (1 / abs(POSITIONS).max(1)).astype(np.float32)
        self._place = _places(coarse)

    def features(self, before: State, after: State) -> tuple[np.ndarray, np.ndarray]:
        """What every vertex reads after a frame, ``(B, V, features)``, and its axes ``(B, V, 3 axes, 3)``."""
        unit, dt = self._unit, self._dt
        x, v, old = (_vertices(a) for a in (after.positions, after.velocities, before.velocities))
        u, change = v * (dt / unit), (v - old) * (dt / unit)
        near = (x[:, self._at[0]] - x[:, :, None]) / unit
        turn = _axes(near)
        vectors = [near * self._nearer[:, None], u[:, self._at[1]] - u[:, :, None]]
        vectors += [change[:, self._at[2]] - change[:, :, None], u[:, :, None], change[:, :, None]]
        vectors.append(np.broadcast_to(np.array([0, 0, 1], np.float32), (*x.shape[:2], 1, 3)))
        if self.scene.wind is not None:
            wind = after.wind.astype(np.float32)[:, None, None] * (dt / unit)
            vectors.append(np.broadcast_to(wind, (*x.shape[:2], 1, 3)))
        numbers = [np.broadcast_to(self._place, (len(x), *self._place.shape))]
        for k, body in enumerate(self.scene.colliders):
            ends = after.colliders[:, None, k].astype(np.float32)
            gap = x - ends[:, :, 0]
            if body.kind == "plane":
                distance = (gap * ends[:, :, 1]).sum(-1, keepdims=True) / unit
            else:
                length = np.sqrt((gap * gap).sum(-1, keepdims=True))
                distance = (length - np.float32(body.radius)) / unit
                vectors.append((gap / length * np.exp(-np.clip(distance, 0, FAR) / 2))[:, :, None])
            numbers.append(np.clip(distance, -1, FAR))
        inner = np.concatenate(vectors, 2) @ np.swapaxes(turn, -1, -2)
        return np.concatenate([inner.reshape(*x.shape[:2], -1), *numbers], -1), turn

    def answer(self, features: np.ndarray, turn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The shift [m] and the change of velocity [m/s] of every vertex, ``(B, V, 3)``; 0 at handles."""
        a = self.arrays
        y = np.clip(features, a["low"], a["high"])
        for k in range(LAYERS):
            y = (np.maximum(y, 0) if k else y) @ a[f"weight{k}"].T + a[f"bias{k}"]
        y = y / np.sqrt(1 + (y / a["limit"]) ** 2) * self.share[:, None]
        out = y.reshape(*y.shape[:2], 2, 3) @ turn * self._unit
        return out[:, :, 0], out[:, :, 1] / self._dt

    def compiled(self) -> Correct:
        """``features``, ``answer`` and ``apply`` in one, with the arrays as they are now."""
        a, bodies = self.arrays, self.scene.colliders
        return Correct(
            index=[np.ascontiguousarray(at.T, np.int32) for at in self._at],
            nearer=self._nearer,
            place=np.ascontiguousarray(self._place.T),
            share=self.share,
            weights=[a[f"weight{k}"] for k in range(LAYERS)],
            biases=[a[f"bias{k}"] for k in range(LAYERS)],
            low=a["low"],
            high=a["high"],
            limit=a["limit"],
            spacing=self._unit,
            frame_dt=self._dt,
            wind=self.scene.wind is not None,
            planes=[body.kind == "plane" for body in bodies],
            radii=[body.radius for body in bodies],
        )

    def apply(self, after: State, features: np.ndarray, turn: np.ndarray) -> None:
        """Correct ``after`` in place."""
        fields = after.positions, after.velocities
        for field, change in zip(fields, self.answer(features, turn), strict=True):
            field += change.swapaxes(1, 2).reshape(field.shape)


def _vertices(field: np.ndarray) -> np.ndarray:
    """``(B, 3, h, w)`` as ``(B, V, 3)`` in float32."""
    return np.ascontiguousarray(field.reshape(len(field), 3, -1).swapaxes(1, 2), np.float32)


def _neighbours(coarse: Scene, away: np.ndarray) -> np.ndarray:
    """Numbers of the vertices ``away`` ``(P, 2)`` from each, ``(V, P)``; beyond the border that on it."""
    rows, cols = coarse.grid.shape
    row, col = np.indices((rows, cols)).reshape(2, -1, 1)
    return np.clip(row + away[:, 0], 0, rows - 1) * cols + np.clip(col + away[:, 1], 0, cols - 1)


def _axes(near: np.ndarray) -> np.ndarray:
    """Two tangents evenly about the sheet's lines, and the normal, from the eight nearest: ``(B, V, 3 axes, 3)``."""

    def unit(a: np.ndarray) -> np.ndarray:
        return a / np.sqrt((a * a).sum(-1, keepdims=True) + np.float32(1e-12))

    across, along = near[..., 0, :] - near[..., 1, :], near[..., 2, :] - near[..., 3, :]
    normal = unit(np.cross(across, along))
    middle = unit(across) + unit(along)
    middle = unit(middle - (middle * normal).sum(-1, keepdims=True) * normal)
    side = np.cross(normal, middle)
    half = np.float32(np.sqrt(0.5))
    return np.stack([(middle - side) * half, (middle + side) * half, normal], -2)


def _from_handles(coarse: Scene) -> np.ndarray:
    """Vertices to the nearest handle, ``(V,)``; infinite without handles."""
    rows, cols = coarse.grid.shape
    at = np.stack(np.divmod(np.array(coarse.handles, np.intp), cols))
    gap = np.indices((rows, cols)).reshape(2, -1, 1) - at[:, None]
    return np.sqrt((gap**2).sum(0)).min(1, initial=np.inf)


def _share(coarse: Scene) -> np.ndarray:
    """How much of its answer a vertex gets, ``(V,)``: 0 at handles, 1 far from them."""
    return -np.expm1(-((_from_handles(coarse) / FADE) ** 2)).astype(np.float32)


def _places(coarse: Scene) -> np.ndarray:
    """How near the four sides and the nearest handle are, ``(V, 10)``, each by two exponentials."""
    rows, cols = coarse.grid.shape
    row, col = np.indices((rows, cols)).reshape(2, -1)
    away = [(side, REACHES) for side in (row, rows - 1 - row, col, cols - 1 - col)]
    away.append((_from_handles(coarse), HANDLE_REACHES))
    return np.stack([np.exp(-side / reach) for side, reaches in away for reach in reaches], 1).astype(np.float32)


def weights_name(scene: str) -> str:
    """The checkpoint of a scene."""
    return f"dynamics_{scene.lower()}"


def shipped(scene: str, factor: int) -> dict[str, np.ndarray]:
    """The arrays of a shipped correction.

    Raises:
        ValueError: there is none.
    """
    arrays = of_factor(weights_name(scene), factor)
    if not arrays:
        raise ValueError(
            f'correction="learned" has no weights for {scene} at factor {factor}: leave it out, or train one with '
            f"`minicloth train dynamics --scenes {scene} --factors {factor}`"
        )
    return arrays
