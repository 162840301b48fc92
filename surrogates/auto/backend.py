"""The backend ``"auto"``: the cheapest that held a tolerance when it was measured, watched while it runs."""

from collections.abc import Mapping, Sequence

import numpy as np

from cloth_envs.arguments import as_number, as_whole
from cloth_envs.backend import Backend, check_material, keywords
from cloth_envs.material import Material
from cloth_envs.registry import load_backend, make_backend
from cloth_envs.scene import Scene
from cloth_envs.state import Controls, State
from surrogates.auto.table import HORIZONS, Option, Table, choose

USUAL = 3.0  # %, tolerance
SHARE = 0.05  # of the members of a verified stretch that may end beyond the tolerance
CLOTH = ("positions", "velocities")


class AutoBackend:
    """The cheapest backend that holds a tolerance, and a closer one where it turns out that it does not.

    Beyond what the table knows (another preset, grid or material) it is the reference.

    Args:
        scene: what is stepped. num_envs: members of the batch.
        tolerance: mean distance of the cloth's vertices from the reference's, ``horizon`` frames after both began
            alike [% of the cloth's length]; 3 where neither this nor ``budget_ms`` is given.
        horizon: 1, 5, 10 or 25 frames.
        budget_ms: instead of a tolerance: the closest backend whose frame took at most that on the table's machine.
        verify: share of the frames that run on the reference too, in stretches of ``horizon`` frames that begin at the
            cloth as it is. Where over ``SHARE`` of the members end beyond the tolerance a closer backend goes on, for
            the whole batch until all are reset at once: up to then members are those of single environments.
        threads: over members of the batch, for backends that take it.

    Attributes:
        level: how often it has taken a closer one.
        measured_error: of each member whose stretch the last frame ended [% of the cloth's length], ``(B,)``; else NaN.

    Raises:
        ValueError: a bad argument, a tolerance below the chaos floor at this horizon (told), or a budget below all.
    """

    def __init__(
        self, scene: Scene, *, num_envs: int = 1, tolerance: float | None = None, horizon: int = 5,
        budget_ms: float | None = None, verify: float = 0.0, threads: int = 1,
    ) -> None:  # fmt: skip
        if tolerance is not None and budget_ms is not None:
            raise ValueError("tolerance and budget_ms are two ways to choose: give one of them")
        if as_whole(horizon) not in HORIZONS:
            raise ValueError(f"horizon must be one of {', '.join(map(str, HORIZONS))} frames, got {horizon!r}")
        chosen = USUAL if tolerance is None and budget_ms is None else tolerance
        self._tolerance = np.inf if chosen is None else _number("tolerance", chosen)
        self._verify, self._horizon = _number("verify", verify, 0.0, 1.0), int(horizon)
        budget = None if budget_ms is None else _number("budget_ms", budget_ms)
        self._ladder, self._why = choose(scene, chosen, budget, self._horizon)
        self.scene, self.num_envs, self.level = scene, num_envs, 0
        self._materials = [scene.material] * num_envs
        self._backends = [_made(option, scene, num_envs, threads) for option in self._ladder[: None if verify else 1]]
        self._watched = np.zeros(num_envs, bool)  # members that the present stretch has followed from its start
        self._left, self._credit = 0, float(self._horizon)  # frames of the stretch, and those that may be verified
        self.measured_error = np.full(num_envs, np.nan)

    @property
    def inner(self) -> Backend:
        """The backend that steps."""
        return self._backends[self.level]

    @property
    def state(self) -> State:
        """The present state."""
        return self.inner.state

    @property
    def self_contact(self) -> bool:
        """Whether the cloth keeps out of itself."""
        return all(getattr(backend, "self_contact", False) for backend in self._backends)

    @property
    def guarded(self) -> np.ndarray:
        """See ``Backend``."""
        return np.asarray(getattr(self.inner, "guarded", np.zeros(self.num_envs, bool)))

    @property
    def crossings(self) -> np.ndarray:
        """See ``Backend``."""
        return np.asarray(getattr(self.inner, "crossings", np.zeros(self.num_envs, np.int32)))

    @property
    def surrogate(self) -> np.ndarray:
        """Which backend steps each member and why, ``(B,)`` text."""
        option, inner = self._ladder[self.level], getattr(self.inner, "surrogate", np.full(self.num_envs, "", object))
        left = f"{self._ladder[self.level - 1]} left the tolerance of {self._tolerance:g} %"
        told = [f"{option}: {self._beyond(m) or (left if self.level else self._why)}" for m in self._materials]
        return np.array(["; ".join(filter(None, pair)) for pair in zip(told, inner, strict=True)], object)

    def _beyond(self, material: Material) -> str:
        """That nothing is known of errors of ``material``, which is not the scene's; empty where that is known."""
        table = Table.of(self.scene.name)
        why = table.beyond(self.scene, material) if table and material != self.scene.material else ""
        return f"measured on another cloth ({why})" if why else ""

    def check_material(self, material: Material) -> None:
        """Refuse what one of the backends can't step. Raises ValueError: see ``Backend``."""
        for backend in self._backends:
            check_material(backend, material)

    def reset(
        self, state: State, materials: Sequence[Material] | None = None, which: Sequence[int] | None = None
    ) -> None:
        """Start from ``state``; see ``Backend.reset``."""
        chosen = [self.scene.material] * state.batch if materials is None else list(materials)
        for backend in self._backends:
            backend.reset(state, chosen, which)
        if which is None:
            self._materials = chosen
        else:
            for i, material in zip(which, chosen, strict=True):
                self._materials[i] = material
        self._watched[slice(None) if which is None else list(which)] = False
        if which is None or len(which) == self.num_envs:  # equal seeds are equal episodes
            self.level, self._left, self._credit = 0, 0, float(self._horizon)

    def advance(self, controls: Controls) -> State:
        """One frame, and of a verified stretch one of the reference too."""
        self.measured_error = np.full(self.num_envs, np.nan)
        if self._verify and self.inner is not self._backends[-1]:
            self._credit += self._verify
            if not self._left and self._credit >= self._horizon:
                self._credit, self._left = self._credit - self._horizon, self._horizon
                self._backends[-1].reset(self.state, self._materials)
                self._watched[:] = True
        state = self.inner.advance(controls)
        if self._left:
            true = self._backends[-1].advance(controls)
            self._left -= 1
            if not self._left:
                self._judge(state, true)
        return self.state

    def _judge(self, state: State, true: State) -> None:
        """Tell how far the members of a stretch are from the reference, and go on closer where that is too far."""
        gap = np.sqrt(((state.positions - true.positions) ** 2).sum(1)).mean((1, 2), dtype=np.float64)
        self.measured_error = np.where(self._watched, 100 * gap / self.scene.grid.length, np.nan)
        known = self.measured_error[self._watched]
        self._watched[:] = False
        if known.size and (known > self._tolerance).mean() > SHARE:
            self.level += 1
            self.inner.reset(state, self._materials)

    @property
    def memory(self) -> dict[str, np.ndarray]:
        """What all backends remember and, where they are verified, how far that is."""
        found = {f"{k}.{name}": value for k, b in enumerate(self._backends) for name, value in b.memory.items()}
        if self._verify:
            verifying = self._backends[-1].state
            found |= {f"verifying.{name}": getattr(verifying, name) for name in CLOTH}
            whole = np.ones(self.num_envs)
            found |= {"watched": whole * self._watched, "left": whole * self._left}
            found |= {"credit": whole * self._credit, "level": whole * self.level}
        return found

    def recall(self, memory: Mapping[str, np.ndarray]) -> None:
        """Take back, after a ``reset`` of the whole batch, what ``memory`` held."""
        if self._verify:
            verifying = State(**(self.state.arrays() | {name: memory[f"verifying.{name}"] for name in CLOTH}))
            self._backends[-1].reset(verifying, self._materials)
            self._watched = memory["watched"].astype(bool)
            self._left, self.level = int(memory["left"][0]), int(memory["level"][0])
            self._credit = float(memory["credit"][0])
        for k, backend in enumerate(self._backends):
            own = {name.removeprefix(f"{k}."): value for name, value in memory.items() if name.startswith(f"{k}.")}
            if own:
                backend.recall(own)


def _made(option: Option, scene: Scene, num_envs: int, threads: int) -> Backend:
    """A backend of the table, on ``threads`` where it takes any."""
    taken = {"threads": threads} if "threads" in keywords(load_backend(option.backend)) else {}
    return make_backend(option.backend, scene, num_envs=num_envs, backend_kwargs={**option.options, **taken})


def _number(name: str, value: object, low: float = 0.0, high: float = np.inf) -> float:
    """A number from ``low``, exclusively where there is no upper end, to ``high``. Raises ValueError: another."""
    found = as_number(value)
    if found is None or not low <= found <= high or (high == np.inf and found == low):
        wanted = "a positive number" if high == np.inf else f"a number from {low:g} to {high:g}"
        raise ValueError(f"{name} must be {wanted}, got {value!r}")
    return found
