"""The scenes of Chen et al. 2020 (multi-feature super-resolution) as presets of Draping, Hitting and Skirt.

Stated there: 13 sequences of 400 frames of a tablecloth that is held at one of its topmost vertices, drawn at random,
and falls freely, of which 10 are for training; 35 of 1000 of spheres of several radii that hit a tablecloth back and
forth at several places, one of 0.5 m across among those of testing alone; fine cloths of 11,393 vertices, coarse ones
of 749; 7 dances of 30,000 frames together, recorded ones that are 8 times as slow, in skirts of 19,798 and 1,303
vertices. Not stated, so our reading: a cloth of 1 x 1 m with frames of 40 ms, 109 x 105 (11,445) and, at a factor of 4,
28 x 27 (756) vertices; the package's default cloth for its "Gray Interlock"; a vertex is as much cloth as holds it in
``Draping``, since one vertex of so fine a grid would be torn out; how the second cloth hangs; the radii, places and
periods, and which sequences are for testing (the last ones); a skirt of 0.75 m, 1.6 m around, of 97 x 208 (20,176) and
25 x 52 (1,300) vertices. Its dances are the user's to name (``read_motion``), the built-in one is the default.
"""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from array_api_compat import array_namespace

from cloth_envs.figure.entry import check_entry
from cloth_envs.figure.motion import read_motion
from cloth_envs.presets.ball_path import BallPath, to_and_fro
from cloth_envs.scene import Scene
from cloth_envs.scenes.derived import derived
from cloth_envs.scenes.draping import Draping
from cloth_envs.scenes.hitting import CLIPS, HUNG, Hitting
from cloth_envs.scenes.skirt import BLEND, Skirt
from cloth_envs.scenes.starts import either, pleats
from cloth_envs.scenes.task import Start, Task
from cloth_envs.scenes.waistband import check_waistband

RESOLUTION = (109, 105)
COARSE_COLUMNS = 27  # one of the coarse cloth's topmost vertices is held, which the fine one has too
SEED = 2020
RADII, TEST_RADIUS = (0.1, 0.15, 0.2, 0.3), 0.25  # m
END = 0.7  # m, how far from the cloth's plane the sphere turns
CROSSING_X, CROSSING_Z = 0.35, (-0.85, -0.35)  # m, most aside and the heights below the upper edge where it crosses
BELOW = 0.05  # m, least from the upper edge down to the sphere: driven into a clip it leaves cloth nowhere to go
PERIODS = (2.5, 4.5)  # s, there and back
TEMPO = 0.125  # of the recorded dances
TESTED = 2 / 7  # of a dance, its end


class Chen2020(Task):
    """What they share: the grid, and a sequence's number as an option; everything of a sequence follows from it."""

    resolution = RESOLUTION
    options: ClassVar[Mapping[str, float]] = {"sequence": 0}
    sequences: ClassVar[int]  # of the paper
    trained: ClassVar[int]  # the first of them are for training, the others for testing
    frames: ClassVar[int]  # of each
    sequence: ClassVar[int] = 0

    @classmethod
    def with_options(cls, **options: float) -> type[Task]:
        """The task of one ``sequence``. Raises ValueError: the paper has no such sequence."""
        number = options["sequence"]
        if number not in range(cls.sequences):
            raise ValueError(f"preset 'chen2020' has the sequences 0 to {cls.sequences - 1}, got {number!r}")
        own: dict[str, Any] = {"options": options, "sequence": int(number)}
        return derived(cls, cls.__name__, own | cls.of_sequence(int(number)), "with_options", **options)

    @classmethod
    def of_sequence(cls, number: int) -> dict[str, Any]:
        """What else a sequence changes of the class."""
        return {}

    def drawn(self) -> np.random.Generator:
        """What draws the sequence, whatever the episode's seed."""
        return np.random.default_rng([SEED, self.sequence])


def held_place(sequence: int) -> float:
    """Where along the upper edge a sequence of Draping is held, of its length: another coarse vertex in each."""
    order = np.random.default_rng(SEED).permutation(COARSE_COLUMNS)
    return float(order[sequence] / (COARSE_COLUMNS - 1))


class Draping2020(Chen2020, Draping):
    """
    ## Description
    `Draping` after Chen et al. 2020, of 109 x 105 vertices: held at another place of the upper edge in each of 13
    sequences of 400 frames, from where the tablecloth falls freely.

    ## Action Space
    As in `Draping`. With zero actions the held point stays.

    ## Starting State
    As in `Draping`, drawn by the sequence's number alone: every seed moves alike. The goal is random.

    ## Arguments
    `preset="chen2020"`, or `preset={"name": "chen2020", "sequence": 12}`: 0 (the default) to 9 are for training, 10 to
    12 for testing. An episode has the paper's length with `max_episode_steps=400`. `resolution=(28, 27)` is the coarse
    cloth.

    All else is as in `Draping`.
    """

    sequences, trained, frames = 13, 10, 400
    held = held_place(0)

    @classmethod
    def of_sequence(cls, number: int) -> dict[str, Any]:
        return {"held": held_place(number)}

    def spread(self, _: np.random.Generator) -> np.ndarray:
        return super().spread(self.drawn())


class Hitting2020(Chen2020, BallPath, Hitting):
    """
    ## Description
    `Hitting` after Chen et al. 2020, of 109 x 105 vertices: a sphere hits the hung tablecloth back and forth by
    itself, of another size and at another place in each of 35 sequences of 1000 frames.

    ## Action Space
    As in `Hitting`, but it moves the sphere away from its path, by at most 0.3 m along each axis and not nearer than
    5 cm to the height of the clips. With zero actions the sphere keeps to it.

    ## Starting State
    Hanging in three shallow pleats, the sphere 0.7 m away, drawn by the sequence's number alone: every seed moves
    alike. Marked vertex and target are random.

    ## Arguments
    `preset="chen2020"`, or `preset={"name": "chen2020", "sequence": 34}`: 0 (the default) to 30 are for training, with
    radii of 0.1, 0.15, 0.2 and 0.3 m, 31 to 34 for testing, the last two with the unseen radius of 0.25 m. An episode
    has the paper's length with `max_episode_steps=1000`. `resolution=(28, 27)` is the coarse cloth.

    All else is as in `Hitting`.
    """

    sequences, trained, frames = 35, 31, 1000
    radius = RADII[0]

    @classmethod
    def of_sequence(cls, number: int) -> dict[str, Any]:
        return {"radius": TEST_RADIUS if number >= cls.sequences - 2 else RADII[number % len(RADII)]}

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene)
        rng = self.drawn()
        self.end, self.period = END * either(rng), rng.uniform(*PERIODS)
        self.crossing = rng.uniform(-CROSSING_X, CROSSING_X), rng.uniform(*CROSSING_Z)  # x, z [m]
        self.roam(rise=-BELOW - self.radius - self.crossing[1])

    def path(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        y, speed = to_and_fro(time, (self.end, -self.end), self.period)
        xp, still, (x, z) = array_namespace(time), 0.0 * time, self.crossing
        return xp.stack([still + x, y, still + z], axis=1), xp.stack([still, speed, still], axis=1)

    def start(self, rng: np.random.Generator) -> Start:
        positions = pleats(self.scene.grid, CLIPS - 1, HUNG, 1.0)
        ball, _ = self.path(np.zeros(1))
        aim = self.aim(positions, -np.sign(self.end), rng)
        return Start(positions, np.zeros_like(positions), np.tile(ball, (1, 2, 1)), aim)


class Skirt2020(Skirt):
    """
    ## Description
    `Skirt` after Chen et al. 2020, of 97 x 208 vertices, its dance 8 times as slow.

    ## Action Space
    As in `Skirt`. With zero actions the dancer keeps to the dance.

    ## Arguments
    `preset="chen2020"`, or `preset={"name": "chen2020", "tempo": 0.5, "motion": "motions.h5:dance"}`: how fast the
    dance is (0.125), and a recorded one by file and name in place of the built-in one; see `cloth_envs.figure.motion`.
    One that does not begin upright, or takes a limb into the waistband, is refused.
    `"sequence"` 0 to 6 begin at a place of the dance of their own, 0 to 4 for training in its first five sevenths, 5
    and 6 for testing in the rest, which 800 frames do not leave (-1, the default: at a random one). `resolution=(25,
    52)` is the coarse skirt.

    All else is as in `Skirt`.
    """

    resolution = (97, 208)
    options: ClassVar[Mapping[str, float | str]] = {"tempo": TEMPO, "motion": "", "sequence": -1}
    sequences, trained, frames = 7, 5, 800
    sequence: ClassVar[int] = -1
    tempo = TEMPO

    @classmethod
    def with_options(cls, **options: Any) -> type[Task]:
        """The task with another tempo or motion, or of one ``sequence``.

        Raises:
            ValueError: a tempo that is not positive, a motion that is no ``FILE:NAME``, not there, does not begin
                upright or takes a limb into the waistband, or no sequence.
        """
        chosen = {**cls.options, **options}
        if not chosen["tempo"] > 0:
            raise ValueError(f"preset 'chen2020' needs a positive tempo, got {chosen['tempo']!r}")
        if chosen["sequence"] not in range(-1, cls.sequences):
            raise ValueError(
                f"preset 'chen2020' has the sequences 0 to {cls.sequences - 1}, and -1 for none, "
                f"got {chosen['sequence']!r}"
            )
        motion = cls.motion
        if chosen["motion"]:
            path, _, name = chosen["motion"].rpartition(":")
            try:
                motion = read_motion(path, name)
            except OSError as error:
                raise ValueError(
                    f"preset 'chen2020' needs a file and a name as motion, such as 'motions.h5:dance', got "
                    f"{chosen['motion']!r}: {error}"
                ) from error
            check_entry(motion, 0.5 * BLEND * chosen["tempo"], f"motion {name!r} in {path}")
            check_waistband(motion, f"motion {name!r} in {path}")
        own = {"options": chosen, "motion": motion, "tempo": chosen["tempo"], "sequence": int(chosen["sequence"])}
        return derived(cls, cls.__name__, own, "with_options", **chosen)

    def begin(self, rng: np.random.Generator) -> float:
        if self.sequence < 0:
            return super().begin(rng)
        span = self.frames * self.frame_dt * self.tempo
        whole, tests = self.motion.duration, self.sequences - self.trained
        shares = np.linspace(0.0, max(whole * (1 - TESTED) - span, 0.0), self.trained)
        shares = np.append(shares, np.linspace(whole * (1 - TESTED), max(whole - span, whole * (1 - TESTED)), tests))
        return float(shares[self.sequence])
