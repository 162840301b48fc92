"""Numbered binary PLY files: ``cloth_00000.ply``, and ``bodies_00000.ply`` where the scene has bodies."""

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from cloth_envs.export.bodies import joined
from cloth_envs.export.folder import replacing_frames
from cloth_envs.export.series import Frame, Series


def write(series: Series, frames: Iterable[Frame], path: Path) -> None:
    """Write the files into the folder ``path``; the number is the frame's in the recording, the time is a comment."""
    with replacing_frames(path, ".ply") as add:
        for frame in frames:
            about = [f"time {frame.time!r} s", "lengths in m, z up"]
            columns = points(frame.positions, frame.normals) | dict(zip(("s", "t"), series.texture.T, strict=True))
            columns |= zip(("vx", "vy", "vz", "strain"), [*frame.velocities.T, frame.strain], strict=True)
            add("cloth", frame.number, mesh(columns, series.triangles, about))
            if series.bodies:
                bodies = joined(series.bodies, frame.places)
                columns = points(bodies.points, bodies.normals)
                add("bodies", frame.number, mesh(columns, bodies.triangles, about))


def points(positions: np.ndarray, normals: np.ndarray) -> dict[str, np.ndarray]:
    """The columns of ``positions`` and ``normals``, ``(N, 3)``, by the names that readers know."""
    return dict(zip(("x", "y", "z", "nx", "ny", "nz"), [*positions.T, *normals.T], strict=True))


def mesh(columns: Mapping[str, np.ndarray], triangles: np.ndarray, comments: Iterable[str]) -> bytes:
    """The file of one mesh: float32 ``columns`` of its vertices by name, ``triangles`` ``(F, 3)``."""
    vertices = np.rec.fromarrays(list(columns.values()), dtype=[(name, "<f4") for name in columns])
    faces = np.empty(len(triangles), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, triangles
    header = ["ply", "format binary_little_endian 1.0", *(f"comment {text}" for text in comments)]
    header += [f"element vertex {len(vertices)}", *(f"property float {name}" for name in columns)]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    return "\n".join(header).encode() + b"\n" + vertices.tobytes() + faces.tobytes()
