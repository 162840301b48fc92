"""Offscreen pictures of a ``State`` with PyVista; nothing is imported until ``Renderer`` draws."""

from cloth_envs.rendering.framing import Camera
from cloth_envs.rendering.renderer import Renderer

__all__ = ["Camera", "Renderer"]
