"""A learned correction of the coarse dynamics: after every frame each vertex is moved, and its velocity changed.

Every vertex reads what lies 1, 2 and 4 vertices away in its own axes: positions, velocities, what the frame changed of
these, gravity, wind, and how far border, handles and bodies are. A network of two hidden layers answers with a shift
and a change of velocity in the same axes. Turning the scene about the vertical turns the answer. Both are
bounded, and fade out around handles, so that a cloth unlike those of training is not torn.
"""

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
REACHES = np.array([1.5, 6.0])  # vertices over which the border is felt
HANDLE_REACHES = np.array([2.0, 8.0])
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

    Attributes:
        share: how much of its answer a vertex gets, ``(V,)``: 0 at handles, 1 far from them.

    Raises:
        ValueError: a tube.
    """

    def __init__(self, coarse: Scene, arrays: Mapping[str, np.ndarray]) -> None:
        grid = coarse.grid
        if grid.periodic:
            raise ValueError('correction="learned" has no tubes: leave it out')
        self.scene, self.arrays = coarse, dict(arrays)
        self._unit, self._dt = np.float32(grid.row_spacing), np.float32(coarse.frame_dt)
        rows, cols = grid.shape
        row, col = np.indices(grid.shape).reshape(2, -1, 1)  # (V, 1)
        # Numbers of the vertices away from each, (V, P); beyond the border that on it.
        self._at = [
            np.clip(row + away[:, 0], 0, rows - 1) * cols + np.clip(col + away[:, 1], 0, cols - 1)
            for away in (POSITIONS, VELOCITIES, CHANGES)
        ]
        self._nearer = (1 / abs(POSITIONS).max(1)).astype(np.float32)
        down, right = np.divmod(np.array(coarse.handles, np.intp), cols)
        to_handle = np.sqrt((row - down) ** 2 + (col - right) ** 2).min(1, initial=np.inf, keepdims=True)
        self.share = -np.expm1(-((to_handle[:, 0] / FADE) ** 2)).astype(np.float32)
        # How near the four sides and the nearest handle are, (V, 10), each by two exponentials.
        near = [np.exp(-side / REACHES) for side in (row, rows - 1 - row, col, cols - 1 - col)]
        self._place = np.concatenate([*near, np.exp(-to_handle / HANDLE_REACHES)], 1).astype(np.float32)

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
        if self.scene.windy:
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

    def apply(self, after: State, features: np.ndarray, turn: np.ndarray) -> None:
        """Move the vertices of ``after``, and change their velocities, in place."""
        a = self.arrays
        y = np.clip(features, a["low"], a["high"])
        for k in range(LAYERS):
            y = (np.maximum(y, 0) if k else y) @ a[f"weight{k}"].T + a[f"bias{k}"]
        y = y / np.sqrt(1 + (y / a["limit"]) ** 2) * self.share[:, None]
        out = y.reshape(*y.shape[:2], 2, 3) @ turn * self._unit
        for field, change in ((after.positions, out[:, :, 0]), (after.velocities, out[:, :, 1] / self._dt)):
            field += change.swapaxes(1, 2).reshape(field.shape)

    def compiled(self) -> Correct:
        """``features`` and ``apply`` in one, with the arrays as they are now."""
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
            wind=self.scene.windy,
            planes=[body.kind == "plane" for body in bodies],
            radii=[body.radius for body in bodies],
        )


def _vertices(field: np.ndarray) -> np.ndarray:
    """``(B, 3, h, w)`` as ``(B, V, 3)`` in float32."""
    return np.ascontiguousarray(field.reshape(len(field), 3, -1).swapaxes(1, 2), np.float32)


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
