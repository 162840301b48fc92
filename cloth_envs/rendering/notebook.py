"""What a notebook shows of an environment: a small picture and the numbers beside it."""

import base64
from collections.abc import Mapping
from html import escape
from io import BytesIO

from cloth_envs.rendering.renderer import Renderer
from cloth_envs.scene import Scene
from cloth_envs.state import State

WIDTH, HEIGHT = 240, 180  # pixels


def card(scene: Scene, state: State, numbers: Mapping[str, str]) -> str:
    """HTML with a picture of ``state``, left out where what draws it is missing, and ``numbers`` in a table."""
    try:
        picture = f'<td rowspan="{len(numbers) + 1}"><img alt="{escape(scene.name)}" src="{_png(scene, state)}"></td>'
    except (ImportError, RuntimeError, ValueError):  # no PyVista or EGL, another thread or process, no finite cloth
        picture = ""
    rows = "".join(f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in numbers.items())
    return f"<table><tr>{picture}</tr>{rows}</table>"


def _png(scene: Scene, state: State) -> str:
    """A picture as a data URI."""
    from PIL import Image

    renderer, stream = Renderer(scene, width=WIDTH, height=HEIGHT), BytesIO()
    try:
        Image.fromarray(renderer.draw(state)).save(stream, "PNG")
    finally:
        renderer.close()
    return f"data:image/png;base64,{base64.b64encode(stream.getvalue()).decode()}"
