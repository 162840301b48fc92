"""The binary container of glTF 2.0: JSON, and the arrays that it points into."""

import json
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cloth_envs.files import replacing
from cloth_envs.version import __version__

COMPONENTS = {np.dtype("<f4"): 5126, np.dtype("<u4"): 5125}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
VERTEX, INDEX = 34962, 34963  # what a buffer view is for


class Content:
    """The file's JSON and the bytes that it points into."""

    def __init__(self) -> None:
        self.json: dict[str, Any] = {"asset": {"version": "2.0", "generator": f"MiniCloth {__version__}"}}
        self.json |= {name: [] for name in ("accessors", "bufferViews", "meshes", "nodes", "materials")}
        self.bytes: list[bytes] = []
        self.size = 0

    def add(self, kind: str, entry: dict[str, Any]) -> int:
        """Append to a list of the JSON; returns the number."""
        self.json[kind].append(entry)
        return len(self.json[kind]) - 1

    def array(self, values: np.ndarray, use: int | None = None) -> int:
        """An accessor of ``(n,)`` or ``(n, k)`` values, float32 or, for indices, uint32."""
        kind = np.dtype("<u4" if use == INDEX else "<f4")
        values = np.ascontiguousarray(values, kind)
        view = {"buffer": 0, "byteOffset": self.size, "byteLength": values.nbytes} | ({"target": use} if use else {})
        columns = values.reshape(len(values), -1)
        self.bytes.append(values.tobytes())  # a multiple of four bytes, as the format asks for
        self.size += values.nbytes
        accessor = {
            "bufferView": self.add("bufferViews", view),
            "componentType": COMPONENTS[kind],
            "count": len(values),
            "type": TYPES[columns.shape[1]],
            "min": columns.min(0).tolist(),
            "max": columns.max(0).tolist(),
        }
        return self.add("accessors", accessor)

    def vertices(self, attributes: Mapping[str, np.ndarray]) -> dict[str, int]:
        """Accessors of ``(N, k)`` attributes, by name."""
        return {name: self.array(values, VERTEX) for name, values in attributes.items()}

    def save(self, path: Path) -> None:
        """Write the binary container in place of what is there. Raises OSError: it can't be written."""
        text = json.dumps(self.json | {"buffers": [{"byteLength": self.size}]}, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        with replacing(path) as part, part.open("wb") as file:
            file.write(struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + self.size))
            file.write(struct.pack("<I4s", len(text), b"JSON") + text)
            file.write(struct.pack("<I4s", self.size, b"BIN\0"))
            file.writelines(self.bytes)
