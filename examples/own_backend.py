"""A backend of your own: ``minicloth compare Curtain --backend own_backend:Springs --resolutions 19x13``, from here."""

from torch import as_tensor, tensor

from cloth_envs import register_backend
from cloth_envs.physics.explicit.bounds import stable_step
from cloth_envs.physics.laws.drives import hermite
from cloth_envs.physics.laws.stencil import edges
from cloth_envs.physics.solver import Solver

register_backend("springs", "own_backend:Springs")
ALL, LOW, HIGH = slice(None), slice(-1), slice(1, None)  # rows and columns of vertices
ENDS = (ALL, LOW, ALL, HIGH), (LOW, ALL, HIGH, ALL), (LOW, LOW, HIGH, HIGH), (LOW, HIGH, HIGH, LOW)  # of the edges


class Springs(Solver):
    """Springs, weight and firm handles in torch, differentiable; no soft ones, damping, bending, air or bodies."""

    def set_materials(self, which, materials):
        if set(materials) != {self.scene.material} or self.scene.windy or self.scene.colliders:
            raise ValueError("Springs knows one material, no wind and no bodies: choose Curtain, leave randomize out")

    def step(self, old, new, controls):  # a frame of velocity Verlet, at the largest stable step
        scene, held = self.scene, list(self.scene.pins)
        mass, steps = tensor(scene.mass), int(scene.frame_dt / stable_step(scene, scene.material)) + 1
        springs = [(getattr(scene.material, e.modulus) * tensor(e.weight), e.rest) for e in edges(scene.grid)]
        x, v = (as_tensor(a).double() for a in (old.positions, old.velocities))
        ends = (as_tensor(a[:, scene.holding.firm]).mT for a in (controls.handle_positions, controls.handle_velocities))
        drive = scene.frame_dt, x.flatten(2)[..., held], v.flatten(2)[..., held], *ends
        for n in range(steps + 1):
            force = mass * tensor([0.0, 0.0, -scene.gravity])[:, None, None].repeat(len(x), 1, 1, 1)
            for (k, rest), (a, b, c, d) in zip(springs, ENDS, strict=True):
                gap = x[..., c, d] - x[..., a, b]
                pull = k.reshape(gap.shape[2:]) * (1 - rest / gap.norm(dim=1, keepdim=True)) * gap
                force[..., a, b] += pull
                force[..., c, d] -= pull
            v = v + scene.frame_dt / steps * (0.5 if n in (0, steps) else 1) * force / mass
            x = x + scene.frame_dt / steps * v * (n < steps)
            x.flatten(2)[..., held], v.flatten(2)[..., held] = hermite(min(n + 1, steps) / steps, *drive)
        new.positions[:], new.velocities[:] = x, v
