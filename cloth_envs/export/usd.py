"""One USD file: a mesh with points at every frame's time code, bodies as spheres, capsules and planes that move."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from cloth_envs.export.bodies import Body
from cloth_envs.export.series import Frame, Series
from cloth_envs.extras import install
from cloth_envs.rendering import look


def import_usd() -> Any:
    """OpenUSD's ``pxr``. Raises ImportError: missing; says what to install."""
    try:
        import pxr.Gf
        import pxr.Tf
        import pxr.Usd
        import pxr.UsdGeom
        import pxr.Vt
    except ImportError as error:
        raise ImportError(f"exporting to USD needs usd-core ({error}): {install('usd')}") from error
    return pxr


def write(series: Series, frames: Iterable[Frame], path: Path) -> None:
    """Write ``path``: metres, z up, time code t is t frames after the reset. Raises ImportError: no usd-core.

    Raises OSError: it can't be written.
    """
    pxr = import_usd()
    geometry, scene = pxr.UsdGeom, series.scene
    stage = pxr.Usd.Stage.CreateInMemory()
    geometry.SetStageMetersPerUnit(stage, 1.0)
    geometry.SetStageUpAxis(stage, geometry.Tokens.z)
    rate = round(1 / scene.frame_dt, 9)
    stage.SetTimeCodesPerSecond(rate)
    stage.SetFramesPerSecond(rate)
    root = geometry.Xform.Define(stage, f"/{pxr.Tf.MakeValidIdentifier(scene.name)}")
    stage.SetDefaultPrim(root.GetPrim())
    mesh = _cloth(pxr, stage, f"{root.GetPath()}/cloth", series)
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
        for (shift, turn), at, (x, y, z, w) in zip(bodies, frame.translations, frame.quaternions, strict=True):
            shift.Set(pxr.Gf.Vec3d(*at.tolist()), code)
            turn.Set(pxr.Gf.Quatd(float(w), float(x), float(y), float(z)), code)
    stage.SetStartTimeCode(codes[0])
    stage.SetEndTimeCode(codes[-1])
    if not stage.GetRootLayer().Export(str(path)):
        raise OSError(f"can't write {path}: OpenUSD says why above; choose a path that you may write")


def _cloth(pxr: Any, stage: Any, path: str, series: Series) -> Any:
    mesh = pxr.UsdGeom.Mesh.Define(stage, path)
    mesh.CreateFaceVertexCountsAttr(pxr.Vt.IntArray.FromNumpy(np.full(len(series.triangles), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(pxr.Vt.IntArray.FromNumpy(series.triangles.ravel()))
    mesh.CreateSubdivisionSchemeAttr(pxr.UsdGeom.Tokens.none)
    mesh.CreateDoubleSidedAttr(True)
    mesh.SetNormalsInterpolation(pxr.UsdGeom.Tokens.vertex)
    mesh.CreateDisplayColorAttr([_color(pxr, look.CLOTH_FRONT)])
    kind = pxr.Sdf.ValueTypeNames.TexCoord2fArray
    texture = pxr.UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", kind, pxr.UsdGeom.Tokens.vertex)
    texture.Set(pxr.Vt.Vec2fArray.FromNumpy(series.texture))
    return mesh


def _body(pxr: Any, stage: Any, parent: Any, body: Body) -> tuple[Any, Any]:
    """Define a body; returns its translation and its turn, to be set at every frame."""
    path = f"{parent}/{pxr.Tf.MakeValidIdentifier(body.name)}"
    if body.kind == "plane":
        shape = pxr.UsdGeom.Plane.Define(stage, path)
        shape.CreateWidthAttr(body.length)
        shape.CreateLengthAttr(body.length)
    elif body.length:
        shape = pxr.UsdGeom.Capsule.Define(stage, path)
        shape.CreateHeightAttr(body.length)
        shape.CreateRadiusAttr(body.radius)
    else:
        shape = pxr.UsdGeom.Sphere.Define(stage, path)
        shape.CreateRadiusAttr(body.radius)
    shape.CreateDisplayColorAttr([_color(pxr, look.BODY)])
    double = pxr.UsdGeom.XformOp.PrecisionDouble
    return shape.AddTranslateOp(), shape.AddOrientOp(double)


def _color(pxr: Any, color: str) -> Any:
    return pxr.Gf.Vec3f(*((int(color[i : i + 2], 16) / 255) ** 2.2 for i in (1, 3, 5)))
