"""Numbered binary PLY files: ``cloth_00000.ply``, and ``bodies_00000.ply`` where the scene has bodies."""

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from cloth_envs.export.bodies import moved
from cloth_envs.export.series import Frame, Series


def write(series: Series, frames: Iterable[Frame], path: Path) -> None:
    """Write the files into the folder ``path``; the number is the frame's in the recording, the time is a comment."""
    for frame in frames:
        about = [f"time {frame.time!r} s", "lengths in m, z up"]
        columns = dict(zip(("x", "y", "z"), frame.positions.T, strict=True))
        columns |= zip(("nx", "ny", "nz"), frame.normals.T, strict=True)
        columns |= zip(("s", "t"), series.texture.T, strict=True)
        columns |= zip(("vx", "vy", "vz", "strain"), [*frame.velocities.T, frame.strain], strict=True)
        write_mesh(path / f"cloth_{frame.number:05d}.ply", columns, series.triangles, about)
        if series.bodies:
            places = zip(series.bodies, frame.translations, frame.quaternions, strict=True)
            points = [moved(body, shift, turn) for body, shift, turn in places]
            first = np.cumsum([0, *map(len, points)])
            triangles = [body.triangles + start for body, start in zip(series.bodies, first, strict=False)]
            columns = dict(zip(("x", "y", "z"), np.concatenate(points).T, strict=True))
            write_mesh(path / f"bodies_{frame.number:05d}.ply", columns, np.concatenate(triangles), about)


def write_mesh(path: Path, columns: Mapping[str, np.ndarray], triangles: np.ndarray, comments: Iterable[str]) -> None:
    """One mesh: float32 ``columns`` of its vertices by name, ``triangles`` ``(F, 3)``."""
    vertices = np.rec.fromarrays(list(columns.values()), dtype=[(name, "<f4") for name in columns])
    faces = np.empty(len(triangles), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, triangles
    header = ["ply", "format binary_little_endian 1.0", *(f"comment {text}" for text in comments)]
    header += [f"element vertex {len(vertices)}", *(f"property float {name}" for name in columns)]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    path.write_bytes("\n".join(header).encode() + b"\n" + vertices.tobytes() + faces.tobytes())
