"""The one table of what benchmarks measure: families of methods, each swept into a curve, and who takes part where."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from cloth_envs.backend import Backend, keywords, parse_backend
from cloth_envs.physics.truth import TRUTHS
from cloth_envs.places import check_backend_kwargs
from cloth_envs.registry import load_backend, make_backend
from cloth_envs.scene import Scene
from cloth_envs.state import State
from training.truth import DETAILED

Options = Mapping[str, Any]


@dataclass(frozen=True)
class Participant:
    """One setting of one method: a point of the curve ``family``.

    Attributes:
        backend: its name, or ``"module:factory"``.
        options, fixed: what tells it from others of its family, and what all of them have.
        name: what a chart with a line a participant calls it, if not by family and options.
        coarse: it runs on grids so many times coarser, where it is too slow for the scene's.
    """

    family: str
    backend: str = "reference"
    options: Options = field(default_factory=dict)
    fixed: Options = field(default_factory=dict)
    name: str = ""
    coarse: int = 1

    @property
    def text(self) -> str:
        """``options`` as JSON, for a row."""
        return json.dumps(dict(self.options))

    @property
    def whole(self) -> dict[str, Any]:
        """Everything that ``backend`` is given, the grid's factor first: rows on disk are known by this order."""
        first = {"factor": self.options["factor"]} if "factor" in self.options else {}
        return {**first, **self.fixed, **self.options}

    @property
    def label(self) -> str:
        """``name``, or family and options in a line."""
        return self.name or label(self.family, self.text)

    def build(self, scene: Scene, num_envs: int = 1, threads: int = 1, *, truth: Sequence[State] = ()) -> Backend:
        """Its backend; one that asks for ``truth`` is given that of every frame.

        Raises:
            ValueError: it refuses the scene, its material or an option.
            ImportError: a package that it needs is missing.
        """
        given = {"truth": truth} | ({"threads": threads} if threads > 1 else {})
        taken = {name: given[name] for name in given.keys() & keywords(load_backend(self.backend))}
        return make_backend(self.backend, scene, num_envs=num_envs, backend_kwargs=self.whole | taken)


def label(family: str, options: str) -> str:
    """``miniature similar x2`` or ``admm iterations=10`` from a row's fields."""
    parts: dict[str, Any] = json.loads(options)
    factor = parts.pop("factor", None)
    words = [family, *([f"x{factor:g}"] if factor else []), *(f"{n}={v}" for n, v in parts.items())]
    return " ".join(words)


def _sweep(family: str, backend: str, *sweep: Options, **fixed: Any) -> list[Participant]:
    return [Participant(family, backend, options, fixed) for options in sweep or ({},)]


def _solver(family: str, *sweep: Options, **fixed: Any) -> list[Participant]:
    return _sweep(family, "reference", *sweep, solver=family.split()[0], **fixed)


def _miniature(family: str, *factors: float, **fixed: Any) -> list[Participant]:
    """Of grids ``factors`` times coarser; 1.5 is for measuring only."""
    sweep = _sweep(family, "miniature", *({"factor": n} for n in factors or (2, 3, 4)), **fixed)
    odd = f"{BASELINES}:fractional"
    return [replace(p, backend=odd) if p.options["factor"] == 1.5 else p for p in sweep]


BASELINES = f"{__package__}.baselines"
ALL = (1.5, 2, 3, 4)
ORACLE, FLOOR, NUDGED = "oracle coarse", "chaos floor", "reference, nudged"
# Add a method by a line.
FAMILIES: dict[str, list[Participant]] = {
    sweep[0].family: sweep
    for sweep in (
        _solver("explicit", {}, {"refine": 2}, {"refine": 4}),
        _solver("admm", *({"iterations": n} for n in (1, 3, 10, 30, 100))),
        _solver("admm substeps", *({"iterations": 10, "substeps": n} for n in (4, 16))),
        _solver("implicit", {"tolerance": 1e-1}),
        _solver("implicit substeps", {"scheme": "sdirk2", "tolerance": 1e-1, "substeps": 4}),
        _miniature("coarse bilinear", *ALL, scaling="similar", upscaler="bilinear"),
        _miniature("miniature seed", 2, 4, scaling="seed"),
        _miniature("miniature similar", *ALL, scaling="similar"),
        _miniature("miniature rule", *ALL, scaling="rule"),  # a tension field by two numbers for all scenes
        _miniature("miniature calibrated", scaling="calibrated"),
        _miniature("miniature closure", scaling="closure"),
        _miniature("closure ridge", 2, 4, scaling="closure", upscaler="ridge"),
        _miniature("miniature"),  # as an agent meets it
        _miniature("closure learned", 4, scaling="closure", correction="learned"),
        [Participant("cnn", "cnn")],
        [Participant("mfsr", "mfsr")],
        _sweep("repeat last frame", f"{BASELINES}:Extrapolation"),
        _sweep("constant velocity", f"{BASELINES}:Extrapolation", moving=True),
        _sweep(ORACLE, f"{BASELINES}:Oracle", *({"factor": n} for n in ALL)),
    )
}
# Of what is measured on scenes with super-resolution, which have no fits. On the others that is in docs/mfsr.md.
BESIDE_DETAIL = ("explicit", "coarse bilinear", "miniature similar", "mfsr", "repeat last frame", "constant velocity")
NO_PHYSICS = ("repeat last frame", "constant velocity", ORACLE)  # an edge too long is no failure of these


def takes_part(participant: Participant, scene: str) -> bool:
    """Whether benchmarks of many scenes measure it on ``scene``."""
    family = participant.family
    return family in (*BESIDE_DETAIL, ORACLE) if scene in DETAILED else family != "mfsr"


def truth(name: str, family: str = FLOOR) -> Participant:
    """What makes the truth ``name`` of ``TRUTHS``; from a nudged start its distance from it is the chaos floor."""
    return Participant(family, "reference", {}, {"solver": "explicit", **TRUTHS[name]})


def _one(family: str, name: str = "", coarse: int = 1, **options: Any) -> Participant:
    """A setting of a family that its sweep need not have."""
    return replace(FAMILIES[family][-1], options=options, name=name, coarse=coarse)


STABILITY = [
    _one("explicit", "explicit"),
    _one("admm", "P-ADMM, 10 it.", iterations=10),
    _one("implicit", "implicit, 1/4 grid", 4, max_iterations=100),
    _one("miniature similar", "mini \u00d72 similar", factor=2),
    _one("miniature similar", "mini \u00d74 similar", factor=4),
    _one("miniature calibrated", "mini \u00d74 calibrated", factor=4),
    *(_one("miniature", f"mini \u00d7{n}", factor=n) for n in (2, 3, 4)),
    _one("miniature", "mini \u00d74 unguarded", factor=4, guard=False),
    _one("cnn", "cnn"),
    _one("mfsr", "mfsr"),
]
# What an agent may train on.
ENDURANCE = [
    _one("explicit", "reference"),
    _one("admm", "P-ADMM, 10 it.", iterations=10),
    _one("miniature", factor=2),
    _one("miniature", factor=4),
    _one("cnn", "cnn"),
    _one("implicit", "implicit, 1/4 grid", 4, max_iterations=100),
]
# Every way in which a solver is refined, to the same limit.
CONVERGENCE = [
    *_solver("explicit", *({"refine": n, "dtype": "float64"} for n in (1, 2, 4))),
    *_solver(
        "admm",
        *(
            {"iterations": i, "substeps": n, "dtype": "float64"}
            for n in (1, 4, 16, 64, 256)
            for i in (10, 30, 100, 300, 1000)
            if i * n <= 8000
        ),
    ),
    *_solver(
        "implicit",
        *(
            {"scheme": scheme, "tolerance": 1e-2, "substeps": n, "dtype": "float64"}
            for scheme in ("euler", "sdirk2")
            for n in (1, 2, 4, 8, 16, 32)
        ),
        *({"scheme": "sdirk2", "tolerance": t, "substeps": 4, "dtype": "float64"} for t in (100.0, 10.0, 1.0, 0.1)),
    ),
]
MESH = [
    _one("explicit", dtype="float64", refine=4),  # truth G1: of its error only the mesh is left
    # Stands for wrinkles that the mesh can't hold.
    *_sweep("changed material", f"{BASELINES}:changed", {"compression": 0.1}),
    _one("miniature similar", factor=2),
    # A sheet of twice the mesh, decimated, is not the task's own: no card holds there.
    *(_one("miniature closure", f"closure + local x{n}", factor=n, upscaler="local") for n in (2, 4)),
]
# What agents see, with its edges mended and as it was upscaled.
WRINKLES = [
    Participant(name, "miniature", {"factor": n, **options}, name=name)
    for n in (2, 4)
    for name, options in ((f"mini \u00d7{n}", {}), (f"mini \u00d7{n} not mended", {"mend": False, "guard": False}))
]
# Whole episodes; the first, off by a nudge, is what the reference is from itself.
LONG_RUNS = [
    Participant(FLOOR, name=NUDGED),
    *(_one("miniature", f"mini \u00d7{n}", factor=n) for n in (2, 4)),
    *(_one("miniature rule", f"rule \u00d7{n}", factor=n) for n in (2, 4)),
    *(_one("miniature calibrated", f"calibrated \u00d7{n}", factor=n) for n in (2, 4)),
    _one("miniature similar", "similar \u00d74", factor=4),
]
# What ``backend="auto"`` may choose.
CHOICES = [FAMILIES["explicit"][0], *FAMILIES["miniature"], FAMILIES["closure learned"][-1]]
# What policies are trained on; the first is what they are scored on.
TRANSFER = [
    _one("explicit", "reference"),
    *(_one("miniature similar", f"similar x{n}", factor=n) for n in (2, 4)),
    *(_one("miniature", factor=n) for n in (2, 4)),
    _one("miniature", "miniature x4 longer", factor=4),
]


def extra(texts: Sequence[str]) -> list[Participant]:
    """Those that ``--backend NAME[=JSON]`` or ``module:Class[=JSON]`` named, each a family of its own.

    Raises:
        ValueError, ImportError: an unknown backend, or options that are no JSON object or that it does not name.
    """
    found = [Participant(name, name, options) for name, options in map(parse_backend, texts)]
    for one in found:
        check_backend_kwargs(one.backend, one.options, shell=True)
    return found


def swept(families: Sequence[str] | None = None, *, quick: bool = False) -> list[Participant]:
    """All of ``families`` (default: all); ``quick`` takes the ends of every sweep."""
    chosen = [FAMILIES[name] for name in FAMILIES if families is None or name in families]
    return [p for sweep in chosen for p in (sweep[:: max(1, len(sweep) - 1)] if quick else sweep)]
