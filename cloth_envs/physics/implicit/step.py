"""One cloth's frame by implicit steps: the stages of a scheme, each the minimum of a potential."""

from dataclasses import dataclass

import _minicloth_kernels as kernels
import numpy as np

from cloth_envs.material import Material
from cloth_envs.physics.implicit.lbfgs import Secants, minimise
from cloth_envs.physics.implicit.prefactored import implicit_system
from cloth_envs.physics.laws.drives import hermite
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
        drag, self.material = material.drag, kernel_material(material)
        self.h, self.firm = scene.frame_dt / substeps, scene.holding.firm
        handles = np.array(scene.handles, np.int32)
        self.held = handles[self.firm]
        self.tau = tau = GAMMA[scheme] * self.h
        if scheme == "euler":  # as the explicit solver: exact for a constant force
            self.decay = np.exp(-drag * tau)
            self.push = -np.expm1(-drag * tau) / (drag * tau) if drag * tau > 0 else 1.0
        else:
            self.decay = self.push = 1 / (1 + drag * tau)
        self._scale = SHARE * (1 + material.damping / tau)
        self._system = implicit_system(scene, material, tau * np.sqrt(self.push * self._scale))
        self._still = np.zeros((len(self.held), 3))
        # The springs of soft handles: which of the 3 n coordinates they hold, how stiffly, which places they have.
        stiffness = scene.grip_stiffness(material).T
        axis, soft = np.nonzero(np.where(self.firm, 0.0, stiffness))
        self._drawn = (axis * scene.grid.vertices + handles[soft]).astype(np.int32)
        self._pull, self._soft = stiffness[axis, soft], (axis, soft)
        self.iterations, self.residual = 0, 0.0

    def solve(self, g: np.ndarray) -> np.ndarray:
        """The inverse initial Hessian, of ``M / (push tau^2) + SHARE (1 + damping / tau) K``, times ``g``."""
        right = np.ascontiguousarray(g.reshape(3, -1).T) / self._scale
        return self._system.solve(right, self._still, np.empty_like(right)).T.ravel()

    def frame(self, x: np.ndarray, v: np.ndarray, drive: Drive) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities ``(3, n)`` at the end of the frame."""
        self.iterations, self.residual = 0, 0.0
        secants = Secants(self.window, x.size)
        for k in range(self.substeps):
            s0, s1 = k / self.substeps, (k + 1) / self.substeps
            if self.scheme == "euler":
                bodies = drive.bodies_at(s0)
                x, v, _ = self._stage(drive, secants, x, x, v, v, x, bodies, bodies, s1)
            else:
                x, v = self._sdirk2(x, v, drive, secants, s0, s1)
            v[:, self.held] = drive.handles_at(s1)[1][:, self.firm]
        return x, v

    def _sdirk2(
        self, x: np.ndarray, v: np.ndarray, drive: Drive, secants: Secants, s0: float, s1: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """``x1 = x + tau v1``, then ``x2 = x + (h - tau) v1 + tau v2``, the same for v; ``tau = (1 - 1/sqrt 2) h``.

        The acceleration of the first stage, without the reactions of contact (an impact is not repeated), is
        ``(v1 - v) / tau``. Directions and areas come from places, and the air's lagged speeds from velocities, that
        are right to O(h^2): order 2 stays. Where there is air this takes the first stage twice.
        """
        rest, held = self.h - self.tau, self.held
        middle = s0 + GAMMA["sdirk2"] * (s1 - s0)
        bodies0, bodies1 = drive.bodies_at(s0), drive.bodies_at(middle)
        place, speed = (a[:, self.firm] for a in drive.handles_at(middle))
        base = x.copy()
        base[:, held] = place - self.tau * speed  # so that dashpots feel the handles' own velocity
        slide = v
        for _ in range(1 if self.scene.air is None else 2):
            given = base, v, slide, x + self.tau * v, bodies0, bodies0, middle
            x1, v1, reaction = self._stage(drive, secants, x, *given)
            v1[:, held] = speed
            slide = v1
        acceleration = ((x1 - x) / self.tau - v) / self.tau - reaction / self.mass
        base = x + rest * v1
        place, speed = (a[:, self.firm] for a in drive.handles_at(s1))
        base[:, held] = place - self.tau * speed
        carried = bodies0 + rest / self.tau * (bodies1 - bodies0)
        along, slide = x + self.h * v1, v + self.h * acceleration
        slide[:, held] = speed
        return self._stage(drive, secants, x, base, v + rest * acceleration, slide, along, bodies0, carried, s1)[:2]

    def _stage(
        self,
        drive: Drive,
        secants: Secants,
        before: np.ndarray,
        base: np.ndarray,
        velocity: np.ndarray,
        slide: np.ndarray,
        along: np.ndarray,
        bodies_before: np.ndarray,
        bodies_base: np.ndarray,
        end: float,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions, velocities ``(x - base) / tau`` and reactions of contact [N], ``(3, n)``, at ``end`` of the frame.

        ``before`` is where the vertices were when the bodies ``(C, 2, 3)`` were at ``bodies_before`` (contact is swept
        from there), the decay of ``velocity`` by drag is still to come, ``along`` gives the directions of the dashpots
        and the cells' normals and areas, the velocities ``slide`` how fast the air slides along cells for its lift, and
        passes through them for what it takes of corners that are faster than their cell.
        Touching vertices get the velocity of their body.
        """
        guess = base + self.tau * self.decay * velocity
        target = guess.copy()
        target[2] -= self.tau**2 * self.push * self.scene.gravity
        places = drive.handles_at(end)[0]
        guess[:, self.held] = places[:, self.firm]
        self.potential.begin(
            material=self.material,
            tau=self.tau,
            inertia=1 / (self.push * self.tau**2),
            base=base.ravel(),
            along=along.ravel(),
            target=target.ravel(),
            velocity=slide.ravel(),
            wind=drive.wind,
            pressure=drive.pressure,
        )
        self.potential.draw(self._drawn, self._pull, places[self._soft])
        self.contact.begin(before.ravel(), base.ravel(), bodies_before, bodies_base, drive.bodies_at(end), self.tau)
        found = minimise(
            self.potential,
            self.contact,
            self.solve,
            guess.ravel(),
            self.mass,
            enough=self.enough,
            max_iterations=self.max_iterations,
            secants=secants,
        )
        self.iterations += found.iterations
        self.residual = max(self.residual, found.residual / GRAVITY)
        v = (found.x - base.ravel()) / self.tau
        reaction = np.empty_like(v)
        self.contact.finish(found.x, found.gradient, found.free_gradient, v, reaction)
        return found.x.reshape(3, -1), v.reshape(3, -1), reaction.reshape(3, -1)
