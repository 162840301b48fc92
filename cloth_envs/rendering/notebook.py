"""What a notebook shows of a cloth: a small picture and the numbers."""

from base64 import b64encode
from html import escape
from io import BytesIO

import numpy as np

from cloth_envs.extras import missing
from cloth_envs.rendering.renderer import Renderer
from cloth_envs.rendering.sheet import vertex_strain
from cloth_envs.scene import Scene
from cloth_envs.state import State

WIDTH, HEIGHT = 240, 180  # pixels


def card(title: str, scene: Scene, state: State | None) -> str:
    """HTML of the first member of ``state``: its picture, where it can be drawn, time and largest strain."""
    lines, picture = [escape(title)], ""
    if state is not None:
        strain = np.abs(vertex_strain(state.positions[0].astype(float), scene.grid)).max()
        lines.append(f"time {state.time[0]:.2f} s, largest strain {100 * strain:.2g} %")
        picture = image(scene, state)
    return f"{picture}<div><code>{'<br>'.join(lines)}</code></div>"


def image(scene: Scene, state: State) -> str:
    """The first member as an ``<img>``, or a sentence that says why there is none."""
    renderer = Renderer(scene, width=WIDTH, height=HEIGHT)
    try:
        from PIL import Image

        picture = renderer.draw(state)
    except ImportError as error:
        return f"<div>no picture: {escape(missing('it', error))}</div>"
    except (RuntimeError, ValueError) as error:  # nowhere to draw, or nothing finite
        return f"<div>no picture: {escape(str(error))}</div>"
    finally:
        renderer.close()
    png = BytesIO()
    Image.fromarray(picture).save(png, "png")
    source = f"data:image/png;base64,{b64encode(png.getvalue()).decode()}"
    return f'<img width="{WIDTH}" alt="{escape(scene.name)}" src="{source}">'
