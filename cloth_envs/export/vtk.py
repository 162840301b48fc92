"""ParaView's collection: a ``.pvd`` file that names a ``.vtp`` file of the cloth and one of the bodies at each time."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from cloth_envs.export.bodies import joined
from cloth_envs.export.folder import replacing_frames
from cloth_envs.export.series import Frame, Series
from cloth_envs.files import replacing
from cloth_envs.rendering.canvas import import_pyvista


def write(series: Series, frames: Iterable[Frame], path: Path) -> None:
    """Write the collection ``path`` and the folder of its name with the meshes.

    The cloth has ``velocity`` [m/s], ``strain``, normals and texture coordinates; its part is 0, that of the bodies,
    with normals and their number as ``body``, is 1. Raises ImportError: PyVista is missing.
    """
    pv = import_pyvista()
    root = ElementTree.Element("VTKFile", type="Collection", version="0.1", byte_order="LittleEndian")
    collection = ElementTree.SubElement(root, "Collection")
    with replacing(path) as part, replacing_frames(path.with_suffix(""), ".vtp") as add:
        for frame in frames:
            meshes = {"cloth": _cloth(pv, series, frame)}
            if series.bodies:
                meshes["bodies"] = _bodies(pv, series, frame)
            for number, (name, mesh) in enumerate(meshes.items()):
                file = add(name, frame.number, _text(mesh))
                about = {"timestep": repr(frame.time), "group": "", "part": str(number), "name": name}
                ElementTree.SubElement(collection, "DataSet", about, file=f"{file.parent.name}/{file.name}")
        ElementTree.indent(root)
        part.write_bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True))


def _cloth(pv: Any, series: Series, frame: Frame) -> Any:
    mesh = pv.PolyData.from_regular_faces(frame.positions, series.triangles)
    mesh.point_data["velocity"] = frame.velocities
    mesh.point_data["strain"] = frame.strain
    mesh.point_data.active_normals = frame.normals
    mesh.active_texture_coordinates = series.texture
    return mesh


def _bodies(pv: Any, series: Series, frame: Frame) -> Any:
    bodies = joined(series.bodies, frame.places)
    mesh = pv.PolyData.from_regular_faces(bodies.points, bodies.triangles)
    mesh.point_data["body"] = bodies.numbers
    mesh.point_data.active_normals = bodies.normals
    return mesh


def _text(mesh: Any) -> bytes:
    """The ``.vtp`` file of a mesh, made in memory: VTK's own writing to a full disk ends the process."""
    from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter

    writer = vtkXMLPolyDataWriter()
    writer.SetInputData(mesh)
    writer.SetDataModeToBinary()
    writer.SetWriteToOutputString(True)
    writer.Write()
    text: str = writer.GetOutputString()
    return text.encode()
