"""Recorded trajectories as files that other programs open: one module a format, on one ``Series``.

All keep metres, seconds and the frame's length. z is up where the format can say so; glTF's is y, so its root is
turned.
"""

from cloth_envs.export.write import FORMATS, export

__all__ = ["FORMATS", "export"]
