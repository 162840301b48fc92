"""Recorded trajectories as files that other programs open: one module a format, on one ``Series``.

All keep metres and seconds. z is up; in glTF, where y is, the root is turned.
"""

from cloth_envs.export.write import FORMATS, export

__all__ = ["FORMATS", "export"]
