"""One binary glTF 2.0 file: the cloth as morph targets, one a frame, bodies as nodes that move.

The weight of a frame's target rises to 1 at its time and falls to 0 at the next, so players go straight from one frame
to the next. A capsule whose length varies has one target. The root node turns z up to glTF's y up; Blender turns it
back.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from cloth_envs.export.bodies import Body
from cloth_envs.export.glb import INDEX, Content
from cloth_envs.export.series import Frame, Series
from cloth_envs.rendering import look

Z_UP = [-np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]  # quaternion of the root
LIMIT = 2**32  # bytes of a file
JSON = 2000  # bytes of JSON that a frame takes, at most
SAME_LENGTH = 1e-5  # m; capsules whose length varies by less are rigid


def write(series: Series, frames: Iterable[Frame], path: Path) -> None:
    """Write the ``.glb`` file ``path``. Raises ValueError: it would be larger than the format can be."""
    check_size(series)
    content, shown = Content(), list(frames)
    times = content.array(np.array([frame.time for frame in shown]))
    channels: list[tuple[int, str, int]] = []  # node, what of it, accessor of its values
    node = content.add("nodes", {"name": "cloth", "mesh": _cloth(content, series, shown)})
    if len(shown) > 1:
        channels.append((node, "weights", content.array(np.eye(len(shown))[:, 1:].ravel())))
    for number, body in enumerate(series.bodies):
        places = [frame.places[number] for frame in shown]
        mesh, weights = _body(content, body, np.array([place.length for place in places]))
        turns = np.array([place.quaternion for place in places])
        turns[1:] *= np.cumprod(np.where((turns[1:] * turns[:-1]).sum(1) < 0, -1, 1))[:, None]  # the short way round
        start = {"translation": places[0].translation.tolist(), "rotation": turns[0].tolist()}
        node = content.add("nodes", {"name": body.name, "mesh": mesh, **start})
        channels.append((node, "translation", content.array(np.array([place.translation for place in places]))))
        channels.append((node, "rotation", content.array(turns)))
        if len(weights):
            channels.append((node, "weights", content.array(weights)))
    parts = list(range(len(content.json["nodes"])))
    root = content.add("nodes", {"name": series.scene.name, "rotation": Z_UP, "children": parts})
    content.json |= {"scenes": [{"name": series.scene.name, "nodes": [root]}], "scene": 0}
    if channels:
        content.json["animations"] = [
            {
                "name": series.scene.name,
                "samplers": [{"input": times, "interpolation": "LINEAR", "output": out} for *_, out in channels],
                "channels": [
                    {"sampler": i, "target": {"node": node, "path": what}} for i, (node, what, _) in enumerate(channels)
                ],
            }
        ]
    content.save(path)


def check_size(series: Series) -> None:
    """Raises ValueError: the file would have more bytes than its header can count."""
    frames, vertices = len(series), len(series.texture)
    each = 24 * vertices + 4 * frames + 32 * len(series.bodies) + JSON  # targets, weights, places
    size = frames * each + 100 * vertices  # and the mesh itself
    if size > LIMIT:
        raise ValueError(
            f"{frames} frames of {vertices} vertices are {size / 2**30:.1f} GiB in glTF, which holds {LIMIT >> 30}: "
            "export each K-th frame with every=K (--every K), or to another format"
        )


def _cloth(content: Content, series: Series, frames: list[Frame]) -> int:
    """The mesh of the cloth: its first frame, and what is added to it in each of the others."""
    first = frames[0]
    attributes = {
        "POSITION": first.positions,
        "NORMAL": first.normals,
        "TEXCOORD_0": [0, 1] + series.texture * [1, -1],  # v downwards
    }
    targets = {
        f"frame {frame.number}": {
            "POSITION": frame.positions - first.positions,
            "NORMAL": frame.normals - first.normals,
        }
        for frame in frames[1:]
    }
    return _mesh(content, "cloth", attributes, series.triangles, look.CLOTH_FRONT, targets)


def _body(content: Content, body: Body, lengths: np.ndarray) -> tuple[int, np.ndarray]:
    """The mesh of a body at its least length [m], and the weights ``(T,)`` of a target at its greatest, if it grows."""
    low, high = float(lengths.min()), float(lengths.max())
    attributes = {"POSITION": body.stretched(low), "NORMAL": body.normals}
    if high - low < SAME_LENGTH:
        return _mesh(content, body.name, attributes, body.triangles, look.BODY), np.empty(0)
    weights = (lengths - low) / (high - low)
    longest = {f"length {high:.6g} m": {"POSITION": body.stretched(high) - body.stretched(low)}}
    return _mesh(content, body.name, attributes, body.triangles, look.BODY, longest, float(weights[0])), weights


def _mesh(
    content: Content,
    name: str,
    attributes: Mapping[str, np.ndarray],
    triangles: np.ndarray,
    color: str,
    targets: Mapping[str, Mapping[str, np.ndarray]] = MappingProxyType({}),
    weight: float = 0.0,
) -> int:
    """A mesh of one material; its morph ``targets`` by name, each of which has ``weight`` at first."""
    channels = np.array([int(color[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    surface = {"baseColorFactor": [*(channels**2.2).round(4).tolist(), 1.0], "metallicFactor": 0.0}  # linear colours
    material = content.add("materials", {"name": name, "doubleSided": True, "pbrMetallicRoughness": surface})
    primitive: dict[str, Any] = {"attributes": content.vertices(attributes), "material": material}
    primitive["indices"] = content.array(triangles.ravel(), INDEX)
    mesh: dict[str, Any] = {"name": name, "primitives": [primitive]}
    if targets:
        primitive["targets"] = [content.vertices(target) for target in targets.values()]
        mesh |= {"weights": [weight] * len(targets), "extras": {"targetNames": list(targets)}}
    return content.add("meshes", mesh)
