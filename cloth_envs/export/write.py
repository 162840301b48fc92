"""``export``: one trajectory of a recording, in one of ``FORMATS``."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from cloth_envs.export.series import Frame, Series
from cloth_envs.files import check_file, check_folder
from cloth_envs.naming import resolve, unknown_name
from cloth_envs.progress import announce, progress
from cloth_envs.recording import Rollout

Writer = Callable[[Series, Iterable[Frame], Path], None]


@dataclass(frozen=True)
class Format:
    """Where its writer is, the suffixes its file may have, the first by default (none: a folder), and what it is."""

    writer: str
    suffixes: tuple[str, ...]
    about: str


FORMATS = {
    "vtk": Format("cloth_envs.export.vtk:write", (".pvd",), "ParaView: a .pvd file and a folder of .vtp files"),
    "gltf": Format("cloth_envs.export.gltf:write", (".glb",), "Blender and viewers: one animated .glb file"),
    "ply": Format("cloth_envs.export.ply:write", (), "a folder of numbered .ply files"),
    "usd": Format("cloth_envs.export.usd:write", (".usdc", ".usda", ".usd"), "Blender, Houdini, Omniverse: one file"),
}


def export(
    file: str | Path, *, format: str, out: str | Path | None = None, trajectory: int = 0, every: int = 1
) -> Path:
    """Write every ``every``-th frame of one trajectory of the recording ``file``; returns the file or folder.

    ``out`` is the file, or a folder in which it gets the recording's name; by default it stands beside the recording.

    Raises:
        ValueError: an unknown format, another suffix, no recording, no such trajectory, an empty one or one that is
            not finite, or more than the format can hold.
        OSError: the output can't be written; what was there before stays whole.
        ImportError: the format's package is missing; says what to install.
    """
    if format not in FORMATS:
        raise unknown_name("format", format, FORMATS)
    if every < 1:
        raise ValueError(f"every must be at least 1, got {every}")
    kind = FORMATS[format]
    write: Writer = resolve(kind.writer)
    with Rollout.open(file) as rollout:
        series = Series(rollout, trajectory, every)
        path = _target(Path(file), kind, format, out)
        rows, cols = series.scene.grid.shape
        what = f"{len(series)} frames of {series.scene.name}, {rows} x {cols} vertices"
        announce(f"{file}: {what}, as {format} into {path}")
        write(series, progress(series, "export", len(series), unit="frame"), path)
    return path


def _target(source: Path, kind: Format, name: str, out: str | Path | None) -> Path:
    """Where it goes; a file is checked that it can be written, a folder when its writer begins."""
    if not kind.suffixes:
        return source.with_name(f"{source.stem}_{name}") if out is None else Path(out)
    if out is None:
        return check_file(source.with_suffix(kind.suffixes[0]))
    path = Path(out)
    if path.is_dir() or not path.suffix:
        return check_file(check_folder(path) / f"{source.stem}{kind.suffixes[0]}")
    return check_file(path, suffixes=kind.suffixes)
