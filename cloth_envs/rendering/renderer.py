"""``Renderer``: frames and depth images of a ``State``, offscreen, with one plotter for all of them."""

import os
import sys
from collections.abc import Sequence
from ctypes.util import find_library
from typing import Any

import numpy as np

from cloth_envs.extras import install
from cloth_envs.rendering import framing, look
from cloth_envs.rendering.framing import Camera
from cloth_envs.scene import Scene
from cloth_envs.state import State
from cloth_envs.style import INK

CAPTION_HEIGHT = 34  # pixels kept free for a caption
LIBRARIES = "apt-get install libegl1 libgl1 libgl1-mesa-dri libxrender1"  # what a bare Linux lacks


def import_pyvista() -> Any:
    """PyVista, set to render through EGL on Linux so that no display is needed.

    Raises:
        ImportError: PyVista or a library that it loads is missing; says what to install.
    """
    if sys.platform.startswith("linux"):
        os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
    try:
        import pyvista
    except ImportError as error:
        raise ImportError(
            f"rendering needs PyVista ({error}): {install('render')}, and on a bare Linux also {LIBRARIES}"
        ) from error
    return pyvista


def check_window(class_name: str) -> None:
    """Refuse VTK's last resort, OSMesa, when that library is missing too: drawing would crash.

    Raises:
        ImportError: neither EGL nor OSMesa; says what to install.
    """
    if class_name == "vtkOSOpenGLRenderWindow" and find_library("OSMesa") is None:
        raise ImportError(f"rendering found no working EGL library: {LIBRARIES}")


class Renderer:
    """Draws states of one scene side by side, offscreen.

    The first picture decides the camera, the ground and each view's resolution; later ones only move what
    is there. The camera keeps its direction and goes along only when the handles (or, without handles, the
    bodies) move further than a quarter of the cloth's size. Use it with one thread at a time.

    Args:
        scene: what is drawn; a state may have another resolution than its grid.
        width, height: size of the picture [pixels].
        views: how many states stand side by side.
        captions: a text for every view.
        color: ``"fabric"`` or ``"strain"`` (structural strain of the edges).
        strain_range: strain at the ends of the colours (0.05 is 5 %).
        camera: where the camera stands, and stays; by default it is chosen to show the scene.

    Raises:
        ValueError: an unknown colour, or numbers that do not fit.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        width: int = 640,
        height: int = 480,
        views: int = 1,
        captions: Sequence[str] | None = None,
        color: str = "fabric",
        strain_range: float = 0.05,
        camera: Camera | None = None,
    ) -> None:
        if color not in ("fabric", "strain"):
            raise ValueError(f'color must be "fabric" or "strain", got {color!r}')
        if views < 1 or width < 16 * views or height < 16:
            raise ValueError(f"{views} views do not fit in {width} x {height} pixels; ask for a larger picture")
        if not strain_range > 0:
            raise ValueError(f"strain_range must be positive, got {strain_range!r}")
        if captions is not None and len(captions) != views:
            raise ValueError(f"got {len(captions)} captions for {views} views; give one caption a view")
        self.scene, self.width, self.height, self.views = scene, int(width), int(height), int(views)
        self.captions, self.camera = captions, camera
        self.strain_range = strain_range if color == "strain" else None
        self._plotter: Any = None
        self._views: list[Any] = []

    def draw(self, states: State | Sequence[State], *, member: int = 0) -> np.ndarray:
        """A picture ``(height, width, 3)`` uint8 of one member of each of ``views`` states.

        Raises:
            ValueError: another number of states than views, another resolution than in the first picture,
                or positions that are not finite.
            ImportError: PyVista or EGL is missing; says what to install.
        """
        self._show(states, member)
        self._plotter.render()
        return np.array(self._plotter.screenshot(None, return_img=True)[..., :3])

    def depth(self, state: State, *, member: int = 0) -> np.ndarray:
        """Distance [m] from the camera's plane ``(height, width)`` float32, ``inf`` where nothing is.

        Measured along the camera's axis. The cloth, bodies, what holds the cloth and the ground count;
        shadow, wind arrow and texts do not.

        Raises:
            ValueError: the renderer has more than one view, or what ``draw`` raises.
        """
        if self.views != 1:
            raise ValueError(f"depth needs a renderer with views=1, this one has {self.views}")
        self._show(state, member)
        from vtkmodules.vtkCommonCore import vtkFloatArray

        view, plotter = self._views[0], self._plotter
        view.solid_only(True)
        plotter.renderer.SetUseFXAA(False)
        plotter.renderer.ResetCameraClippingRange()
        plotter.render()
        # Plotter.get_image_depth converts in float32, where the empty background can't be told from far things.
        buffer: Any = vtkFloatArray()  # an array to NumPy, unknown to its stubs
        plotter.render_window.GetZbufferData(0, 0, self.width - 1, self.height - 1, buffer)
        z = np.frombuffer(buffer, np.float32).astype(float).reshape(self.height, self.width)[::-1]
        near, far = plotter.camera.clipping_range
        view.solid_only(False)
        plotter.renderer.SetUseFXAA(True)
        return np.where(z < 1, near * far / (far - z * (far - near)), np.inf).astype(np.float32)

    def close(self) -> None:
        """Free the plotter; calling it again does nothing."""
        if self._plotter is not None:
            self._plotter.close()
            self._plotter, self._views = None, []

    def _show(self, states: State | Sequence[State], member: int) -> None:
        states = [states] if isinstance(states, State) else list(states)
        if len(states) != self.views:
            raise ValueError(
                f"got {len(states)} states for {self.views} views; pass one state a view, or Renderer(views=...)"
            )
        for state in states:
            if not (np.isfinite(state.positions[member]).all() and np.isfinite(state.colliders[member]).all()):
                raise ValueError("the state's positions are not finite; draw the last finite state instead")
        if self._plotter is None:
            self._build(states, member)
        for view, state in zip(self._views, states, strict=True):
            view.update(state, member)
        for renderer in self._plotter.renderers:
            renderer.ResetCameraClippingRange()

    def _build(self, states: list[State], member: int) -> None:
        pv = import_pyvista()
        from cloth_envs.rendering.view import View

        theme = pv.themes.Theme()
        theme.anti_aliasing, theme.multi_samples = None, 1
        plotter = pv.Plotter(
            off_screen=True,
            window_size=[self.width, self.height],
            shape=(1, self.views),
            border=False,
            lighting="none",
            theme=theme,
        )
        check_window(plotter.render_window.GetClassName())
        scenes = [framing.at_resolution(self.scene, state.positions.shape[2:]) for state in states]
        boxes = np.stack([framing.reach(scene, state, member) for scene, state in zip(scenes, states, strict=True)])
        box = np.stack([boxes[:, 0].min(0), boxes[:, 1].max(0)])
        corners = np.array(np.meshgrid(*box.T)).reshape(3, -1).T
        towards, below = framing.direction(scenes[0], states[0], member), CAPTION_HEIGHT / self.height
        aspect = self.width / self.views / self.height
        camera = self.camera or framing.fit(corners, towards, aspect, below if self.captions else 0.0)
        follow, strain = self.camera is None, self.strain_range
        views = []
        for index, (scene, state) in enumerate(zip(scenes, states, strict=True)):
            plotter.subplot(0, index)
            views.append(View(pv, plotter, scene, state, member, box, camera, follow=follow, strain_range=strain))
            if self.captions:
                plotter.add_text(self.captions[index], position="lower_edge", font_size=9, color=INK)
            look.smooth_edges(plotter.renderer)
        if self.strain_range is not None:
            mapper, wide = views[-1].sheet.actor.mapper, self.width / self.views
            plotter.add_scalar_bar("strain (%)\n", mapper=mapper, width=46 / wide, position_x=1 - 64 / wide, **look.BAR)
        plotter.show(auto_close=False, interactive=False)
        self._plotter, self._views = plotter, views
