"""ParaView's collection: a ``.pvd`` file that names ``.vtp`` files, one of the cloth and one of the bodies a frame."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from cloth_envs.export.bodies import moved
from cloth_envs.export.series import Frame, Series
from cloth_envs.files import check_folder
from cloth_envs.rendering.canvas import import_pyvista


def write(series: Series, frames: Iterable[Frame], path: Path) -> None:
    """Write the collection ``path`` and the folder of its name with the meshes.

    The cloth has ``velocity`` [m/s], ``strain``, normals and texture coordinates; its part is 0, that of the bodies,
    with their number as ``body``, is 1. Raises ImportError: PyVista is missing.
    """
    pv = import_pyvista()
    folder = check_folder(path.with_suffix(""))
    root = ElementTree.Element("VTKFile", type="Collection", version="0.1", byte_order="LittleEndian")
    collection = ElementTree.SubElement(root, "Collection")
    for frame in frames:
        meshes = {"cloth": _cloth(pv, series, frame)}
        if series.bodies:
            meshes["bodies"] = _bodies(pv, series, frame)
        for part, (name, mesh) in enumerate(meshes.items()):
            file = folder / f"{name}_{frame.number:05d}.vtp"
            mesh.save(file)
            about = {"timestep": repr(frame.time), "group": "", "part": str(part), "name": name}
            ElementTree.SubElement(collection, "DataSet", about, file=f"{folder.name}/{file.name}")
    ElementTree.indent(root)
    ElementTree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


def _cloth(pv: Any, series: Series, frame: Frame) -> Any:
    mesh = pv.PolyData.from_regular_faces(frame.positions, series.triangles)
    mesh.point_data["velocity"] = frame.velocities
    mesh.point_data["strain"] = frame.strain
    mesh.point_data.active_normals = frame.normals
    mesh.active_texture_coordinates = series.texture
    return mesh


def _bodies(pv: Any, series: Series, frame: Frame) -> Any:
    places = zip(series.bodies, frame.translations, frame.quaternions, strict=True)
    points = [moved(body, shift, turn) for body, shift, turn in places]
    first = np.cumsum([0, *map(len, points)])
    triangles = [body.triangles + start for body, start in zip(series.bodies, first, strict=False)]
    mesh = pv.PolyData.from_regular_faces(np.concatenate(points), np.concatenate(triangles))
    mesh.point_data["body"] = np.repeat(np.arange(len(points)), [len(p) for p in points]).astype(np.int32)
    return mesh
