"""``Renderer``: frames and depth images of a ``State``, offscreen, with one plotter for all of them."""

import weakref
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from cloth_envs.marks import Mark
from cloth_envs.rendering.canvas import STUDIO, Canvas
from cloth_envs.rendering.framing import Camera
from cloth_envs.scene import Scene
from cloth_envs.state import State


class Renderer:
    """Draws states of one scene side by side, offscreen.

    A picture depends on what it shows and on the start that it is framed by, not on the pictures before it. The start
    decides where camera, ground and lights stand; the camera keeps its direction and goes along only when the handles
    (or, without handles, the bodies) are further from there than a quarter of the cloth's size. Any thread may use a
    renderer, several one after the other; one that is dropped gives back all it holds, as ``close`` does.

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
        strain = strain_range if color == "strain" else None
        self._canvas = Canvas(scene, self.width, self.height, captions, strain, camera)
        weakref.finalize(self, STUDIO.discard, self._canvas).atexit = False

    def draw(
        self,
        states: State | Sequence[State],
        *,
        start: State | Sequence[State] | None = None,
        member: int = 0,
        marks: Sequence[Mark] = (),
        met: bool = False,
        captions: Sequence[str] | None = None,
    ) -> np.ndarray:
        """A picture ``(height, width, 3)`` uint8 of one member of each of ``views`` states.

        ``start`` holds as many states, which this picture and those after it are framed by; without any, that is what
        the first picture since ``close`` shows. ``marks`` show a goal in every view, in another colour once it is
        ``met``. ``captions`` take the place of those that the renderer was made with.

        Raises:
            ValueError: another number of states than views, another resolution than in the first picture,
                positions that are not finite, or captions for a renderer without room for them.
            ImportError: PyVista or EGL is missing; says what to install.
            RuntimeError: a process that can't draw, since it was forked or is ending; on macOS, a thread that can't.
        """
        if captions is not None and (self._canvas.captions is None or len(captions) != self.views):
            raise ValueError(f"new captions take the place of {self.views} others: make a Renderer(captions=...)")
        job = partial(self._canvas.draw, marks=marks, met=met, captions=captions)
        return self._run(job, states, start, member)

    def depth(self, state: State, *, start: State | None = None, member: int = 0) -> np.ndarray:
        """Distance [m] from the camera's plane ``(height, width)`` float32, ``inf`` where nothing is.

        Measured along the camera's axis, framed as in ``draw``. The cloth, bodies, what holds the cloth and the ground
        count; shadow, wind arrow and texts do not.

        Raises:
            ValueError: the renderer has more than one view, or what ``draw`` raises.
        """
        if self.views != 1:
            raise ValueError(f"depth needs a renderer with views=1, this one has {self.views}")
        return self._run(self._canvas.depth, state, start, member)

    def close(self) -> None:
        """Free the plotter; calling it again does nothing."""
        STUDIO.close(self._canvas)

    def _run(
        self,
        job: Callable[[list[State], list[State] | None, int], np.ndarray],
        states: State | Sequence[State],
        start: State | Sequence[State] | None,
        member: int,
    ) -> np.ndarray:
        starts = None if start is None else self._checked(start, member)
        return STUDIO.run(self._canvas, partial(job, self._checked(states, member), starts, member))

    def _checked(self, states: State | Sequence[State], member: int) -> list[State]:
        """As many as there are views, each finite and computed."""
        states = [states] if isinstance(states, State) else list(states)
        if len(states) != self.views:
            raise ValueError(
                f"got {len(states)} states for {self.views} views; pass one state a view, or Renderer(views=...)"
            )
        for state in states:
            if not (np.isfinite(state.positions[member]).all() and np.isfinite(state.colliders[member]).all()):
                raise ValueError("the state's positions are not finite; draw the last finite state instead")
        return states
