"""One cloth's frame by implicit steps: the stages of a scheme, each the minimum of a potential."""

from dataclasses import dataclass

import _minicloth_kernels as kernels
import numpy as np

from cloth_envs.material import Material
from cloth_envs.physics.implicit.lbfgs import Minimum, Secants, minimise
from cloth_envs.physics.implicit.prefactored import implicit_system
from cloth_envs.physics.laws.step import hermite
from cloth_envs.physics.solver import kernel_material
from cloth_envs.scene import GRAVITY, Scene

# Length of a stage over that of a step. Euler is one stage; sdirk2 has two (Alexander 1977, theorem 5).
GAMMA = {"euler": 1.0, "sdirk2": 1 - 0.5**0.5}
# Share of the springs' full stiffness in the initial Hessian. A slack or sideways moved spring has none, so all of
# it overestimates most directions: 0.3 took 2309 iterations where 1 took 3584 and 0.1 took 2594 (five curtain frames).
SHARE = 0.3

Motion = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]  # positions, velocities at a frame's start; at its end


@dataclass(frozen=True)
class Drive:
    """What moves a cloth in a frame of ``frame_dt`` [s]."""

    frame_dt: float
    handles: Motion  # (3, N)
    bodies: Motion  # (C, 2, 3)
    wind: np.ndarray  # (3,) [m/s]
    pressure: float  # Pa

    def handles_at(self, s: float) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities ``(3, N)`` at ``s`` in [0, 1]."""
        return hermite(s, self.frame_dt, *self.handles)

    def bodies_at(self, s: float) -> np.ndarray:
        """``(C, 2, 3)`` at ``s`` in [0, 1]."""
        return hermite(s, self.frame_dt, *self.bodies)[0]


@dataclass(frozen=True)
class Stage:
    """Where a stage starts from; ``x`` and ``v`` are ``(3, n)``, bodies ``(C, 2, 3)``.

    Velocities are ``(x - base) / tau``. ``before`` is where the vertices were when the bodies were at
    ``bodies_before`` (contact is swept from there), ``along`` gives the directions of the dashpots and the facets'
    normals and areas. Euler: all three are the step's start.
    """

    before: np.ndarray
    base: np.ndarray
    velocity: np.ndarray  # of which the decay by drag is still to come
    along: np.ndarray
    bodies_before: np.ndarray
    bodies_base: np.ndarray
    end: float  # in [0, 1] of the frame


class ImplicitStep:
    """A cloth of one material; ``frame`` steps it. Holds no state between frames but ``iterations``, ``residual``."""

    def __init__(
        self,
        scene: Scene,
        material: Material,
        potential: kernels.Potential,
        contact: kernels.Contact,
        *,
        scheme: str,
        substeps: int,
        tolerance: float,
        max_iterations: int,
        window: int,
    ) -> None:
        self.scene, self.potential, self.contact = scene, potential, contact
        self.scheme, self.substeps, self.window = scheme, substeps, window
        self.enough, self.max_iterations = tolerance * GRAVITY, max_iterations
        self.mass = scene.grid.areas.ravel() * material.areal_density
        drag = material.drag if scene.drag else 0.0
        self.material = kernel_material(scene, material)
        self.h, self.held = scene.frame_dt / substeps, list(scene.handles)
        self.tau = tau = GAMMA[scheme] * self.h
        if scheme == "euler":  # as the explicit solver: exact for a constant force
            self.decay = np.exp(-drag * tau)
            self.push = -np.expm1(-drag * tau) / (drag * tau) if drag * tau > 0 else 1.0
        else:
            self.decay = self.push = 1 / (1 + drag * tau)
        self._scale = SHARE * (1 + material.damping / tau)
        self._system = implicit_system(scene.grid, material, tau * np.sqrt(self.push * self._scale), scene.handles)
        self._still = np.zeros((len(scene.handles), 3))
        self.iterations, self.residual = 0, 0.0

    def solve(self, g: np.ndarray) -> np.ndarray:
        """The inverse initial Hessian, of ``M / (push tau^2) + SHARE (1 + damping / tau) K``, times ``g``."""
        right = np.ascontiguousarray(g.reshape(3, -1).T) / self._scale
        return self._system.solve(right, self._still, np.empty_like(right)).T.ravel()

    def frame(self, x: np.ndarray, v: np.ndarray, drive: Drive) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities ``(3, n)`` at the end of the frame."""
        self.iterations, self.residual = 0, 0.0
        secants = Secants(self.window, x.size)
        step = self._euler if self.scheme == "euler" else self._sdirk2
        for k in range(self.substeps):
            x, v = step(x, v, drive, secants, k / self.substeps, (k + 1) / self.substeps)
            v[:, self.held] = drive.handles_at((k + 1) / self.substeps)[1]
        return x, v

    def _euler(
        self, x: np.ndarray, v: np.ndarray, drive: Drive, secants: Secants, s0: float, s1: float
    ) -> tuple[np.ndarray, np.ndarray]:
        bodies = drive.bodies_at(s0)
        stage = Stage(x, x, v, x, bodies, bodies, s1)
        end = self._minimise(stage, drive, secants)
        return end.x.reshape(x.shape), self._velocities(stage, end)[0]

    def _sdirk2(
        self, x: np.ndarray, v: np.ndarray, drive: Drive, secants: Secants, s0: float, s1: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """``x1 = x + tau v1``, then ``x2 = x + (h - tau) v1 + tau v2``, the same for v; ``tau = (1 - 1/sqrt 2) h``.

        The acceleration of the first stage, without the reactions of contact (an impact is not repeated), is
        ``(v1 - v) / tau``. Directions and areas come from places that are right to O(h^2): order 2 stays.
        """
        rest, held = self.h - self.tau, self.held
        middle = s0 + GAMMA["sdirk2"] * (s1 - s0)
        bodies0, bodies1 = drive.bodies_at(s0), drive.bodies_at(middle)
        place, speed = drive.handles_at(middle)
        base = x.copy()
        base[:, held] = place - self.tau * speed  # so that dashpots feel the handles' own velocity
        first = Stage(x, base, v, x + self.tau * v, bodies0, bodies0, middle)
        end = self._minimise(first, drive, secants)
        v1, reaction = self._velocities(first, end)
        v1[:, held] = speed
        acceleration = ((end.x.reshape(x.shape) - x) / self.tau - v) / self.tau - reaction / self.mass
        base = x + rest * v1
        place, speed = drive.handles_at(s1)
        base[:, held] = place - self.tau * speed
        carried = bodies0 + rest / self.tau * (bodies1 - bodies0)
        second = Stage(x, base, v + rest * acceleration, x + self.h * v1, bodies0, carried, s1)
        end = self._minimise(second, drive, secants)
        return end.x.reshape(x.shape), self._velocities(second, end)[0]

    def _minimise(self, stage: Stage, drive: Drive, secants: Secants) -> Minimum:
        guess = stage.base + self.tau * self.decay * stage.velocity
        target = guess.copy()
        target[2] -= self.tau**2 * self.push * self.scene.gravity
        guess[:, self.held] = drive.handles_at(stage.end)[0]
        self.potential.begin(
            material=self.material,
            tau=self.tau,
            inertia=1 / (self.push * self.tau**2),
            base=stage.base.ravel(),
            along=stage.along.ravel(),
            target=target.ravel(),
            wind=drive.wind,
            pressure=drive.pressure,
        )
        self.contact.begin(
            stage.before.ravel(),
            stage.base.ravel(),
            stage.bodies_before,
            stage.bodies_base,
            drive.bodies_at(stage.end),
            self.tau,
        )
        end = minimise(
            self.potential,
            self.contact,
            self.solve,
            guess.ravel(),
            self.mass,
            enough=self.enough,
            max_iterations=self.max_iterations,
            secants=secants,
        )
        self.iterations += end.iterations
        self.residual = max(self.residual, end.residual / GRAVITY)
        return end

    def _velocities(self, stage: Stage, end: Minimum) -> tuple[np.ndarray, np.ndarray]:
        """Velocities, those of touching vertices made their body's, and the reactions of contact [N], ``(3, n)``."""
        v = (end.x - stage.base.ravel()) / self.tau
        reaction = np.empty_like(v)
        self.contact.finish(end.x, end.gradient, end.free_gradient, v, reaction)
        return v.reshape(3, -1), reaction.reshape(3, -1)
