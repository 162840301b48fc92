"""Videos and images that commands write."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from types import ModuleType

import numpy as np

from cloth_envs.extras import install
from cloth_envs.files import check_file, check_folder, replacing, why_cut, write_bytes
from cloth_envs.marks import Mark
from cloth_envs.progress import progress
from cloth_envs.rendering import Camera, Renderer, framing
from cloth_envs.rendering.canvas import CAPTION_HEIGHT, import_pyvista
from cloth_envs.scene import Scene
from cloth_envs.state import State

ENDED = "ffmpeg ended before the last picture"
AROUND = np.concatenate([np.eye(3), -np.eye(3)])  # of a ball of radius 1, six points


def import_imageio() -> ModuleType:
    """imageio with its ffmpeg. Raises ImportError: missing; says what to install."""
    try:
        import imageio.v2
        import imageio_ffmpeg  # noqa: F401
    except ImportError as error:
        raise ImportError(f"pictures and videos need imageio ({error}): {install('render')}") from error
    return imageio.v2


@contextmanager
def open_video(path: Path, fps: float) -> Iterator[Callable[[np.ndarray], None]]:
    """What adds a picture to an H.264 file that every player knows; pictures have even sides.

    The file replaces an older one when it is whole.

    Raises:
        OSError: it can't be written; nothing of it is left.
        ValueError: no pictures were added.
    """
    imageio, count = import_imageio(), 0
    import imageio_ffmpeg

    with replacing(path) as part:
        stream = imageio.get_writer(
            part, fps=fps, codec="libx264", quality=8, macro_block_size=2, pixelformat="yuv420p",
            ffmpeg_log_level="fatal",
        )  # fmt: skip

        def add(picture: np.ndarray) -> None:
            nonlocal count
            try:
                stream.append_data(picture)
            except OSError as error:  # with ffmpeg's whole command line
                raise why_cut(part, ENDED) from error
            count += 1

        try:
            yield add
        finally:
            with suppress(OSError):  # what is missing is seen below
                stream.close()
        if count == 0:
            raise ValueError(f"there are no pictures for {path}: give at least one frame")
        try:
            whole = imageio_ffmpeg.count_frames_and_secs(part)[0] == count
        except RuntimeError:
            whole = False
        if not whole:
            raise why_cut(part, ENDED)


def planned(path: str) -> str:
    """``path`` as a plan names it: of a file, whether it replaces one."""
    return f"{path} (replaces the old one)" if Path(path).is_file() else path


def check_pictures(video: str | None, images: str | None) -> None:
    """That ``video`` (an ``.mp4`` file) and ``images`` (a folder, made if need be) can be written and drawn.

    Raises:
        ImportError: a package is missing; says what to install.
        OSError, ValueError: an output that can't be written.
    """
    if video is not None:
        check_file(video, suffixes=(".mp4",))
    if images is not None:
        check_folder(images)
    if video is not None or images is not None:
        import_imageio()
        import_pyvista()


@dataclass(frozen=True)
class Goal:
    """What a picture shows of the goal: its ``marks``, whether it is ``met``, and two lines under it, or none."""

    marks: Sequence[Mark] = ()
    met: bool = False
    words: str | None = None


def write_pictures(
    scene: Scene,
    states: Sequence[State],
    *,
    video: str | None,
    images: str | None,
    strain: bool,
    goals: Sequence[Goal] = (),
) -> None:
    """Draw ``states`` to an H.264 video at the simulated speed, to numbered PNG images, to both or to none.

    ``goals`` are those of every state, with words in all or none; without any none is drawn.

    Raises:
        OSError: a file can't be written; what was there stays, and no broken one is left.
        ValueError: there are no states.
    """
    if video is None and images is None:
        return
    if not states:
        raise ValueError(f"there are no frames to draw to {video or images}: give at least one")
    with ExitStack() as stack:
        goals = goals or [Goal()] * len(states)
        captions = None if goals[0].words is None else [goals[0].words]
        below = 0.0 if captions is None else CAPTION_HEIGHT / 480
        marks = [mark for goal in goals[:: max(1, len(goals) // 40)] for mark in goal.marks]
        camera = fixed_camera(scene, [states], aspect=4 / 3, below=below, marks=marks)
        renderer = Renderer(scene, color="strain" if strain else "fabric", camera=camera, captions=captions)
        stack.callback(renderer.close)
        add = None if video is None else stack.enter_context(open_video(Path(video), 1 / scene.frame_dt))
        for number, state in enumerate(progress(states, "pictures", unit="frame")):
            goal = goals[number]
            words = None if goal.words is None else [goal.words]
            picture = renderer.draw(state, marks=goal.marks, met=goal.met, captions=words)
            if add is not None:
                add(picture)
            if images is not None:
                write_bytes(Path(images) / f"frame_{number:05d}.png", as_png(picture))


def as_png(picture: np.ndarray) -> bytes:
    """What a PNG file of a picture ``(height, width, 3)`` holds: a library that writes it itself fails untidily."""
    from PIL import Image

    content = BytesIO()
    Image.fromarray(picture).save(content, "png")
    return content.getvalue()


def fixed_camera(
    scene: Scene, runs: Sequence[Sequence[State]], *, aspect: float, below: float = 0.0, marks: Sequence[Mark] = ()
) -> Camera:
    """A camera that shows all of ``runs`` from start to end, each at a resolution of its own, arrows and ``marks``.

    ``aspect`` is the picture's width over its height; ``below`` the share of the height to keep free under them.
    """
    points = []
    for states in runs:
        own = framing.at_resolution(scene, states[0].positions.shape[2:])
        lattice = own.grid.keypoints(min(9, own.grid.rows), min(9, own.grid.cols))
        ground = framing.reach(own, states[0])[0, 2]
        under = np.array([*states[0].positions[0, :2].mean((1, 2)), ground])
        for state in states[:: max(1, len(states) // 40)]:
            points.append(state.positions[0].reshape(3, -1).T[lattice])
            points.append(np.array([[*framing.anchor(own, state, 0)[:2], ground]]))
            speed = float(np.linalg.norm(state.wind[0]))
            if own.windy and speed > 0:
                tip = state.wind[0] / speed * framing.arrow_length(own, speed) / 2
                points.append(under + np.stack([tip, -tip]))
            for body, ends in zip(scene.colliders, state.colliders[0], strict=True):
                points += [end + body.radius * AROUND for end in ends if body.radius]
    for mark in marks:
        if mark.kind != "onlooker":
            points += [mark.points + mark.radius * side for side in AROUND]
    towards = framing.direction(scene, runs[0][0])
    return framing.fit(np.concatenate(points).astype(float), towards, aspect, below)
