"""``Canvas``: PyVista's plotter and what stands in it; used in the studio only."""

import ctypes
import os
import sys
from collections.abc import Sequence
from ctypes.util import find_library
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cloth_envs.extras import install
from cloth_envs.marks import Mark
from cloth_envs.rendering import framing, look
from cloth_envs.rendering.framing import Camera
from cloth_envs.rendering.studio import Studio
from cloth_envs.scene import Scene
from cloth_envs.state import State
from cloth_envs.style import INK

CAPTION_HEIGHT = 50  # pixels kept free for a caption of two lines
LIBRARIES = "apt-get install libegl1 libgl1 libgl1-mesa-dri libxrender1"  # what a bare Linux lacks


def import_pyvista() -> Any:
    """PyVista, set to render through EGL on Linux so that no display is needed.

    Raises:
        ImportError: PyVista or what it loads to draw is missing; says what to install.
    """
    if sys.platform.startswith("linux"):
        os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
    try:
        import pyvista.plotting  # it loads matplotlib, and VTK's libraries for windows
    except ImportError as error:
        raise ImportError(
            f"rendering needs PyVista and matplotlib ({error}): {install('render')}, and on a bare Linux also "
            f"{LIBRARIES}"
        ) from error
    return pyvista


def check_window(class_name: str) -> None:
    """Refuse VTK's last resort, OSMesa, when that library is missing too: drawing would crash.

    Raises:
        ImportError: neither EGL nor OSMesa; says what to install.
    """
    if class_name == "vtkOSOpenGLRenderWindow" and find_library("OSMesa") is None:
        raise ImportError(f"rendering found no working EGL library: {LIBRARIES}")


_spare: dict[tuple[int, int, int], Any] = {}  # the plotter closed last, empty, by its width, height and views


def empty_plotter(pv: Any, size: tuple[int, int, int]) -> tuple[Any, bool]:
    """A plotter of ``size`` without anything in it, and whether it has been shown: the spare one, or a new one.

    Windows that come and go leave 24 kB of compiled code each in Mesa, and holes of 8 MB in the heap.
    """
    if size in _spare:
        return _spare.pop(size), True
    theme = pv.themes.Theme()
    theme.anti_aliasing, theme.multi_samples = None, 1
    plotter = pv.Plotter(
        off_screen=True, window_size=list(size[:2]), shape=(1, size[2]), border=False, lighting="none", theme=theme
    )
    pv.plotting.plotter._ALL_PLOTTERS.pop(plotter._id_name, None)  # or pyvista.close_all() would close it anywhere
    check_window(plotter.render_window.GetClassName())
    return plotter, False


def close_spare() -> None:
    """Give back the spare plotter."""
    while _spare:
        _spare.popitem()[1].close()


STUDIO = Studio(close_spare)


def framed_by(starts: Sequence[State], member: int) -> list[np.ndarray]:
    """All that framing depends on: copies of the cloths and bodies."""
    return [part[member].copy() for start in starts for part in (start.positions, start.colliders)]


@dataclass(eq=False)
class Canvas:
    """One plotter, made with the first picture; its arguments are those of ``Renderer``."""

    scene: Scene
    width: int
    height: int
    captions: Sequence[str] | None
    strain_range: float | None
    camera: Camera | None
    plotter: Any = None
    views: list[Any] = field(default_factory=list)
    texts: list[Any] = field(default_factory=list)
    framed: list[np.ndarray] = field(default_factory=list)  # the cloths and bodies that the pictures are framed by

    @property
    def is_open(self) -> bool:
        """Whether there is a window."""
        return self.plotter is not None

    def draw(
        self,
        states: Sequence[State],
        starts: Sequence[State] | None,
        member: int,
        marks: Sequence[Mark] = (),
        met: bool = False,
        captions: Sequence[str] | None = None,
    ) -> np.ndarray:
        """See ``Renderer.draw``."""
        self._show(states, starts, member)
        for view in self.views:
            view.goals.show(marks, met, view.ground.height)
        for text, words in zip(self.texts, captions or (), strict=False):
            text.set_text("lower_edge", words)
        self.plotter.render()
        return np.array(self.plotter.screenshot(None, return_img=True)[..., :3])

    def depth(self, states: Sequence[State], starts: Sequence[State] | None, member: int) -> np.ndarray:
        """See ``Renderer.depth``."""
        self._show(states, starts, member)
        from vtkmodules.vtkCommonCore import vtkFloatArray

        view, plotter = self.views[0], self.plotter
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
        if self.plotter is not None:
            plotter, self.plotter, self.views, self.texts, self.framed = self.plotter, None, [], [], []
            plotter.clear()
            close_spare()
            _spare[self._size(len(plotter.renderers))] = plotter

    def abandon(self) -> None:
        """Keep the windows for ever: in a forked process Python and VTK would hang where they free them."""
        plotters = [*_spare.values(), *([] if self.plotter is None else [self.plotter])]
        for plotter in plotters:
            plotter.render_window.Register(None)
        for kept in (self, plotters):
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(kept))

    def _size(self, views: int) -> tuple[int, int, int]:
        return self.width, self.height, views

    def _show(self, states: Sequence[State], starts: Sequence[State] | None, member: int) -> None:
        for view, start in zip(self.views, starts or (), strict=False):
            view.check(start)
        try:
            if self.plotter is None:
                self._build(starts or states, member)
            elif starts:
                self._frame(starts, member)
        except BaseException:  # half of a picture serves nobody
            if self.plotter is not None:
                self.plotter.close()
            self.plotter, self.views, self.texts, self.framed = None, [], [], []
            raise
        for view, state in zip(self.views, states, strict=True):
            view.update(state, member)
        for renderer in self.plotter.renderers:
            renderer.ResetCameraClippingRange()

    def _frame(self, starts: Sequence[State], member: int) -> None:
        if not all(map(np.array_equal, self.framed, framed_by(starts, member))):
            box, camera = self._space([view.scene for view in self.views], starts, member)
            for view, start in zip(self.views, starts, strict=True):
                view.frame(start, member, box, camera)
            self.framed = framed_by(starts, member)

    def _space(self, scenes: Sequence[Scene], starts: Sequence[State], member: int) -> tuple[np.ndarray, Camera]:
        """What may be occupied and the camera; see ``framing.together``."""
        below, aspect = CAPTION_HEIGHT / self.height, self.width / len(starts) / self.height
        box, camera = framing.together(scenes, starts, member, aspect, below if self.captions else 0.0)
        return box, self.camera or camera

    def _build(self, starts: Sequence[State], member: int) -> None:
        pv = import_pyvista()
        from cloth_envs.rendering.view import View

        count = len(starts)
        self.plotter, shown = empty_plotter(pv, self._size(count))
        plotter = self.plotter
        scenes = [framing.at_resolution(self.scene, start.positions.shape[2:]) for start in starts]
        box, camera = self._space(scenes, starts, member)
        follow, strain = self.camera is None, self.strain_range
        for index, (scene, start) in enumerate(zip(scenes, starts, strict=True)):
            plotter.subplot(0, index)
            self.views.append(View(pv, plotter, scene, start, member, box, camera, follow=follow, strain_range=strain))
            if self.captions:
                text = plotter.add_text(self.captions[index], position="lower_edge", font_size=9, color=INK)
                self.texts.append(text)
            look.smooth_edges(plotter.renderer)
        if strain is not None:
            mapper, wide = self.views[-1].sheet.actor.mapper, self.width / count
            plotter.add_scalar_bar("strain (%)\n", mapper=mapper, width=46 / wide, position_x=1 - 64 / wide, **look.BAR)
        self.framed = framed_by(starts, member)
        if not shown:
            plotter.show(auto_close=False, interactive=False)
