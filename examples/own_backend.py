"""A backend of your own: ``minicloth compare Curtain --backend own_backend:Springs --resolutions 19x13``, from here."""

from torch import autograd, tensor

from cloth_envs import register_backend
from cloth_envs.physics.explicit.stability import stable_step
from cloth_envs.physics.laws.drives import hermite
from cloth_envs.physics.laws.stencil import edges
from cloth_envs.physics.solver import Solver


class Springs(Solver):
    """Springs, weight and handles in torch, forces by autograd; no damping, bending, air or bodies."""

    def __init__(self, scene, *, num_envs=1):
        super().__init__(scene, num_envs=num_envs, threads=1, dtype="float32")
        self.mass, self.steps = tensor(scene.mass.ravel()), int(scene.frame_dt / stable_step(scene, scene.material)) + 1
        self.springs = [(getattr(scene.material, e[0]) * tensor(e[4]), *map(tensor, e[1:4])) for e in edges(scene.grid)]

    def set_materials(self, which, materials):
        if set(materials) != {self.scene.material}:
            raise ValueError("Springs has the scene's material: leave randomize out")

    def energy(self, x):  # [J], at positions (B, 3, H * W) [m]
        stretch = [(k, (x.index_select(2, a) - x.index_select(2, b)).norm(dim=1) - L) for k, a, b, L in self.springs]
        return sum((k * s**2).sum() / 2 for k, s in stretch) + (self.mass * self.scene.gravity * x[:, 2]).sum()

    def step(self, old, new, controls):  # a frame of symplectic Euler
        x, v = (tensor(a).double().flatten(2) for a in (old.positions, old.velocities))
        ends = (tensor(a).mT for a in (controls.handle_positions, controls.handle_velocities))
        held, h = list(self.scene.handles), self.scene.frame_dt / self.steps
        drive = self.scene.frame_dt, x[..., held], v[..., held], *ends
        for n in range(1, self.steps + 1):
            v = v - h / self.mass * autograd.grad(self.energy(x.requires_grad_()), x)[0]
            x = x.detach() + h * v
            x[..., held], v[..., held] = hermite(n / self.steps, *drive)
        new.positions[:], new.velocities[:] = (a.reshape(new.positions.shape) for a in (x, v))


register_backend("springs", Springs)
