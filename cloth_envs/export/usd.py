"""One USD file: a mesh with points at every frame's time code, bodies as spheres, capsules and planes that move."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from cloth_envs.export.bodies import Body
from cloth_envs.export.series import Frame, Series
from cloth_envs.extras import install
from cloth_envs.files import replacing, why_cut
from cloth_envs.rendering import look


def import_usd() -> Any:
    """OpenUSD's ``pxr``. Raises ImportError: missing; says what to install."""
    try:
        import pxr.Gf
        import pxr.Sdf
        import pxr.Tf
        import pxr.Usd
        import pxr.UsdGeom
        import pxr.Vt
    except ImportError as error:
        raise ImportError(f"exporting to USD needs usd-core ({error}): {install('usd')}") from error
    return pxr


def write(series: Series, frames: Iterable[Frame], path: Path) -> None:
    """Write ``path``: metres, z up, time code t is t frames after the reset.

    Raises:
        ImportError: no usd-core.
        OSError: it can't be written; what was there stays.
    """
    pxr = import_usd()
    stage = _stage(pxr, series, frames)
    with replacing(path) as part:
        try:
            stage.GetRootLayer().Export(str(part))
            whole = _reads_back(pxr, stage, part)
        except pxr.Tf.ErrorException:
            whole = False
        if not whole:  # USD says so only of some files that were cut short, and never why
            raise why_cut(part, "it does not read back as it was written")


def _stage(pxr: Any, series: Series, frames: Iterable[Frame]) -> Any:
    """All of it, in memory."""
    geometry, scene = pxr.UsdGeom, series.scene
    stage = pxr.Usd.Stage.CreateInMemory()
    geometry.SetStageMetersPerUnit(stage, 1.0)
    geometry.SetStageUpAxis(stage, geometry.Tokens.z)
    rate = round(1 / scene.frame_dt, 9)
    stage.SetTimeCodesPerSecond(rate)
    stage.SetFramesPerSecond(rate)
    root = geometry.Xform.Define(stage, f"/{pxr.Tf.MakeValidIdentifier(scene.name)}")
    stage.SetDefaultPrim(root.GetPrim())
    mesh, strain = _cloth(pxr, stage, f"{root.GetPath()}/cloth", series)
    bodies = [_body(pxr, stage, root.GetPath(), body) for body in series.bodies]
    codes = []
    for frame in frames:
        code = round(frame.time / scene.frame_dt, 6)
        codes.append(code)
        points = pxr.Vt.Vec3fArray.FromNumpy(frame.positions)
        mesh.GetPointsAttr().Set(points, code)
        mesh.GetNormalsAttr().Set(pxr.Vt.Vec3fArray.FromNumpy(frame.normals), code)
        mesh.GetVelocitiesAttr().Set(pxr.Vt.Vec3fArray.FromNumpy(frame.velocities), code)
        mesh.GetExtentAttr().Set(geometry.PointBased.ComputeExtent(points), code)
        strain.Set(pxr.Vt.FloatArray.FromNumpy(frame.strain), code)
        for (shape, shift, turn), (at, (x, y, z, w), length) in zip(bodies, frame.places, strict=True):
            shift.Set(pxr.Gf.Vec3d(*at.tolist()), code)
            turn.Set(pxr.Gf.Quatd(float(w), float(x), float(y), float(z)), code)
            if shape.GetPrim().IsA(geometry.Capsule):
                shape.GetHeightAttr().Set(length, code)
    stage.SetStartTimeCode(codes[0])
    stage.SetEndTimeCode(codes[-1])
    return stage


def _reads_back(pxr: Any, stage: Any, part: Path) -> bool:
    """Whether the file holds every value of ``stage``."""
    written = pxr.Usd.Stage.Open(pxr.Sdf.Layer.OpenAsAnonymous(str(part)))
    for prim in stage.Traverse():
        for meant in prim.GetAuthoredAttributes():
            found = written.GetAttributeAtPath(meant.GetPath())
            for time in meant.GetTimeSamples() or [pxr.Usd.TimeCode.Default()]:
                if not found or not np.array_equal(found.Get(time), meant.Get(time)):
                    return False
    return True


def _cloth(pxr: Any, stage: Any, path: str, series: Series) -> tuple[Any, Any]:
    """Define the cloth's mesh; returns it and its strain, to be set at every frame."""
    mesh = pxr.UsdGeom.Mesh.Define(stage, path)
    mesh.CreateFaceVertexCountsAttr(pxr.Vt.IntArray.FromNumpy(np.full(len(series.triangles), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(pxr.Vt.IntArray.FromNumpy(series.triangles.ravel()))
    mesh.CreateSubdivisionSchemeAttr(pxr.UsdGeom.Tokens.none)
    mesh.CreateDoubleSidedAttr(True)
    mesh.SetNormalsInterpolation(pxr.UsdGeom.Tokens.vertex)
    mesh.CreateDisplayColorAttr([_color(pxr, look.CLOTH_FRONT)])
    kinds, primvars = pxr.Sdf.ValueTypeNames, pxr.UsdGeom.PrimvarsAPI(mesh)
    texture = primvars.CreatePrimvar("st", kinds.TexCoord2fArray, pxr.UsdGeom.Tokens.vertex)
    texture.Set(pxr.Vt.Vec2fArray.FromNumpy(series.texture))
    return mesh, primvars.CreatePrimvar("strain", kinds.FloatArray, pxr.UsdGeom.Tokens.vertex)


def _body(pxr: Any, stage: Any, parent: Any, body: Body) -> tuple[Any, Any, Any]:
    """Define a body; returns it, its translation and its turn, to be set at every frame."""
    path = f"{parent}/{pxr.Tf.MakeValidIdentifier(body.name)}"
    if body.kind == "plane":
        shape = pxr.UsdGeom.Plane.Define(stage, path)
        shape.CreateWidthAttr(body.size)
        shape.CreateLengthAttr(body.size)
    else:
        shape = (pxr.UsdGeom.Capsule if body.kind == "capsule" else pxr.UsdGeom.Sphere).Define(stage, path)
        shape.CreateRadiusAttr(body.size)
    shape.CreateDisplayColorAttr([_color(pxr, look.BODY)])
    double = pxr.UsdGeom.XformOp.PrecisionDouble
    return shape, shape.AddTranslateOp(), shape.AddOrientOp(double)


def _color(pxr: Any, color: str) -> Any:
    return pxr.Gf.Vec3f(*((int(color[i : i + 2], 16) / 255) ** 2.2 for i in (1, 3, 5)))
