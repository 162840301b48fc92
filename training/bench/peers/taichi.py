"""Taichi as a peer: the same springs, explicit and by XPBD, in plain kernels of our own.

The explicit one gathers the forces of a vertex from its twelve neighbours, as tutorials do; whole frames run in one
serial kernel over arrays of structures, the fastest of the four ways tried on one thread (parallel or serial, arrays
of structures or structures of arrays). Annotations of kernels must be real objects: no lazy annotations here.
"""

import math
import os
from functools import cache
from typing import Any

import numpy as np

os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")

import taichi as ti

from cloth_envs.physics.explicit.bounds import stable_step
from cloth_envs.physics.laws.air import OWN
from cloth_envs.physics.laws.stencil import edges, quads
from cloth_envs.scene import Air
from cloth_envs.state import State
from training.bench.peers.scenes import Peer, Setup, clock

PAD = 2  # vertices of no stiffness around the grid: no neighbour is missing


@cache
def start() -> None:
    """Taichi on one thread, once a process."""
    ti.init(arch=ti.cpu, cpu_max_num_threads=1, default_fp=ti.f32, log_level=ti.ERROR)


@ti.data_oriented
class TaichiCloth(Peer):
    """``method`` is ``"explicit"`` (symplectic Euler, ``refine`` times the stable number of substeps) or ``"xpbd"``
    (Macklin et al. 2016, ``substeps`` a frame of ``iterations`` each).
    """

    def __init__(
        self, setup: Setup, method: str = "explicit", refine: float = 1, substeps: int = 1, iterations: int = 1
    ) -> None:
        super().__init__(setup)
        start()
        scene, grid, material = setup.scene, setup.scene.grid, setup.scene.material
        self.method, self.iterations = method, iterations
        if method == "explicit":
            substeps = math.ceil(math.ceil(scene.frame_dt / stable_step(scene, material)) * refine)
        (self.rows, self.cols), self.substeps, self.masses = grid.shape, substeps, scene.mass
        a, b = grid.row_spacing, grid.col_spacing
        # (row, column, class of the spring, rest length) of the neighbour at the far end of a vertex's own springs.
        self.own = ((0, 1, 0, b), (1, 0, 1, a), (1, 1, 2, grid.diagonal), (1, -1, 3, grid.diagonal))
        self.damping = material.damping
        self.gravity, self.drag = scene.gravity, material.drag
        self.windy, air = scene.air is not None, scene.air or Air()
        self.normal, self.lift, self.tangential = (air.density * c for c in (air.normal, air.lift, air.tangential))
        body = scene.colliders[0] if scene.colliders else None
        self.body = body is not None
        self.radius, self.friction = (body.radius + scene.thickness, body.friction) if body else (0.0, 0.0)
        shape = (self.rows + 2 * PAD, self.cols + 2 * PAD)
        self.x, self.v, self.f, self.old = (ti.Vector.field(3, ti.f32, shape=shape) for _ in range(4))
        self.k, self.multiplier = (ti.Vector.field(4, ti.f32, shape=shape) for _ in range(2))
        self.g = ti.Vector.field(3, ti.f32, shape=shape)  # along rows, along columns, twist of the cell
        self.bend = ti.Matrix.field(3, 3, ti.f32, shape=shape)  # multipliers
        self.inverse = ti.field(ti.f32, shape=shape)
        springs, bends = np.zeros((*shape, 4), np.float32), np.zeros((*shape, 3), np.float32)
        for kind, edge in enumerate(edges(grid)):
            row, col = np.divmod(edge.first, grid.cols)
            springs[row + PAD, col + PAD, kind] = getattr(material, edge.modulus) * edge.weight
        areas = grid.areas
        bends[PAD:-PAD, PAD + 1 : -PAD - 1, 0] = (material.bend_stiffness * areas / b**4)[:, 1:-1]
        bends[PAD + 1 : -PAD - 1, PAD:-PAD, 1] = (material.bend_stiffness * areas / a**4)[1:-1]
        bends[PAD : -PAD - 1, PAD : -PAD - 1, 2] = material.bend_stiffness * material.twist * quads(grid).weight
        inverse = np.pad(np.where(setup.pins, 0, 1 / self.masses), PAD).astype(np.float32)
        # Padding needs a place of its own: a spring of no stiffness must still have a length.
        self._padded = np.zeros((*shape, 3), np.float32)
        self._padded[..., 0], self._padded[..., 1] = np.arange(shape[1]), np.arange(shape[0])[:, None]
        for field, values in ((self.k, springs), (self.g, bends), (self.inverse, inverse)):
            field.from_numpy(values)
        self.reset(setup.start)
        self.advance(setup.controls)  # compiles
        self.reset(setup.start)

    def reset(self, state: State, materials: object = None, which: object = None) -> None:
        empty, padded = 0 * self._padded, self._padded
        for field, around, values in ((self.x, padded, state.positions), (self.v, empty, state.velocities)):
            around[PAD:-PAD, PAD:-PAD] = np.moveaxis(values[0], 0, -1)
            field.from_numpy(around)

    def run_frame(self, wind: np.ndarray) -> None:
        h = self.scene.frame_dt / self.substeps
        decay = math.exp(-self.drag * h)
        push = h if self.drag == 0 else (1 - decay) / self.drag
        frame: Any = self.explicit if self.method == "explicit" else self.xpbd
        begin = clock()
        frame(self.substeps, h, decay, push, *wind[0])
        ti.sync()
        self.taken += clock() - begin

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        x, v = (field.to_numpy()[PAD:-PAD, PAD:-PAD].astype(np.float64) for field in (self.x, self.v))
        return np.moveaxis(x, -1, 0), np.moveaxis(v, -1, 0)

    @ti.func
    def internal(self, i, j):  # type: ignore[no-untyped-def]
        """Springs, dashpots and quadratic bending on a vertex."""
        x, v = self.x[i, j], self.v[i, j]
        force = ti.Vector([0.0, 0.0, 0.0])
        for di, dj, kind, rest in ti.static(self.own):
            for side in ti.static((1, -1)):
                k = self.k[i, j][kind] if ti.static(side == 1) else self.k[i - di, j - dj][kind]
                d, w = self.x[i + side * di, j + side * dj] - x, self.v[i + side * di, j + side * dj] - v
                r = 1.0 / ti.sqrt(d.dot(d))
                force += (k * (1.0 - rest * r + self.damping * d.dot(w) * r * r)) * d
        for di, dj, kind in ti.static(((0, 1, 0), (1, 0, 1))):
            before, after = self.x[i - di, j - dj], self.x[i + di, j + dj]
            force += 2.0 * self.g[i, j][kind] * (before - 2.0 * x + after)
            force -= self.g[i - di, j - dj][kind] * (self.x[i - 2 * di, j - 2 * dj] - 2.0 * before + x)
            force -= self.g[i + di, j + dj][kind] * (x - 2.0 * after + self.x[i + 2 * di, j + 2 * dj])
        for di, dj in ti.static(((-1, -1), (-1, 0), (0, -1), (0, 0))):
            p, q = i + di, j + dj
            mixed = self.x[p, q] - self.x[p, q + 1] - self.x[p + 1, q] + self.x[p + 1, q + 1]
            force -= (1.0 if ti.static(di == dj) else -1.0) * self.g[p, q][2] * mixed
        return force

    @ti.func
    def air(self, wind):  # type: ignore[no-untyped-def]
        """The law of ``laws.air`` on cells, added to ``f``."""
        for i in range(PAD, PAD + self.rows - 1):
            for j in range(PAD, PAD + self.cols - 1):
                ul, ur, ll, lr = (i, j), (i, j + 1), (i + 1, j), (i + 1, j + 1)
                normal = (self.x[lr] - self.x[ul]).cross(self.x[ur] - self.x[ll])
                twice = ti.sqrt(normal.dot(normal)) + 1e-20
                n = normal / twice
                mean = (self.v[ul] + self.v[ur] + self.v[ll] + self.v[lr]) / 4.0
                relative = mean - wind
                across = n.dot(relative)
                along = relative - across * n
                speed = ti.sqrt(along.dot(along))
                rate = self.normal * ti.abs(across) + self.lift * speed
                stress = rate * across * n + self.tangential * speed * along
                for corner in ti.static((ul, ur, ll, lr)):
                    own = self.v[corner] - mean
                    self.f[corner] = self.f[corner] - twice / 16.0 * (stress + OWN * rate * own)

    @ti.func
    def settle(self, i, j, x, v, h):  # type: ignore[no-untyped-def]
        """The vertex at ``x``, or out of the sphere at the origin, with Coulomb friction."""
        if ti.static(self.body):
            size = ti.sqrt(x.dot(x))
            if size < self.radius:
                n = x / size
                speed, stop = n.dot(v), ti.max(-n.dot(v), 0.0)
                slide = v - speed * n
                hold = ti.min(self.friction * stop / (ti.sqrt(slide.dot(slide)) + 1e-20), 1.0)
                x = x + (self.radius - size) * n - h * hold * slide
                v = v + stop * n - hold * slide
        self.x[i, j] = x
        self.v[i, j] = v

    @ti.kernel
    def explicit(self, n: ti.i32, h: ti.f32, decay: ti.f32, push: ti.f32, wx: ti.f32, wy: ti.f32, wz: ti.f32):  # type: ignore[no-untyped-def]
        ti.loop_config(serialize=True)
        for _substep in range(n):
            for i in range(PAD, PAD + self.rows):
                for j in range(PAD, PAD + self.cols):
                    self.f[i, j] = self.internal(i, j)
            if ti.static(self.windy):
                self.air(ti.Vector([wx, wy, wz]))
            for i in range(PAD, PAD + self.rows):
                for j in range(PAD, PAD + self.cols):
                    w = self.inverse[i, j]
                    if w > 0.0:
                        v = self.v[i, j] * decay + (self.f[i, j] * w + ti.Vector([0.0, 0.0, -self.gravity])) * push
                        self.settle(i, j, self.x[i, j] + h * v, v, h)

    @ti.func
    def predict(self, wind, h, decay, push):  # type: ignore[no-untyped-def]
        """Where gravity, drag and wind alone would take the vertices; multipliers begin at zero."""
        if ti.static(self.windy):
            for i in range(PAD, PAD + self.rows):
                for j in range(PAD, PAD + self.cols):
                    self.f[i, j] = ti.Vector([0.0, 0.0, 0.0])
            self.air(wind)
        for i in range(PAD, PAD + self.rows):
            for j in range(PAD, PAD + self.cols):
                self.old[i, j] = self.x[i, j]
                w = self.inverse[i, j]
                if w > 0.0:
                    pull = ti.Vector([0.0, 0.0, -self.gravity])
                    if ti.static(self.windy):
                        pull += self.f[i, j] * w
                    self.x[i, j] = self.x[i, j] + h * (self.v[i, j] * decay + pull * push)
                self.multiplier[i, j] = ti.Vector([0.0, 0.0, 0.0, 0.0])
                self.bend[i, j] = ti.Matrix.zero(ti.f32, 3, 3)

    @ti.kernel
    def xpbd(self, n: ti.i32, h: ti.f32, decay: ti.f32, push: ti.f32, wx: ti.f32, wy: ti.f32, wz: ti.f32):  # type: ignore[no-untyped-def]
        ti.loop_config(serialize=True)
        for _substep in range(n):
            self.predict(ti.Vector([wx, wy, wz]), h, decay, push)
            for _iteration in range(self.iterations):
                for i in range(PAD, PAD + self.rows):
                    for j in range(PAD, PAD + self.cols):
                        self.project(i, j, h)
            for i in range(PAD, PAD + self.rows):
                for j in range(PAD, PAD + self.cols):
                    if self.inverse[i, j] > 0.0:
                        self.settle(i, j, self.x[i, j], (self.x[i, j] - self.old[i, j]) / h, h)

    @ti.func
    def project(self, i, j, h):  # type: ignore[no-untyped-def]
        """The springs that a vertex owns, its two bending terms and its cell's twist, one by one (Gauss-Seidel)."""
        for di, dj, kind, rest in ti.static(self.own):
            k = self.k[i, j][kind]
            w, u = self.inverse[i, j], self.inverse[i + di, j + dj]
            if k > 0.0 and w + u > 0.0:
                soft = 1.0 / (k * h * h)
                d = self.x[i + di, j + dj] - self.x[i, j]
                size = ti.sqrt(d.dot(d))
                step = -(size - rest + soft * self.multiplier[i, j][kind]) / (w + u + soft)
                self.multiplier[i, j][kind] = self.multiplier[i, j][kind] + step
                self.x[i, j] = self.x[i, j] - (w * step / size) * d
                self.x[i + di, j + dj] = self.x[i + di, j + dj] + (u * step / size) * d
        for di, dj, kind in ti.static(((0, 1, 0), (1, 0, 1))):
            g = self.g[i, j][kind]
            if g > 0.0:
                before, middle, after = self.inverse[i - di, j - dj], self.inverse[i, j], self.inverse[i + di, j + dj]
                soft = 1.0 / (g * h * h)
                c = self.x[i - di, j - dj] - 2.0 * self.x[i, j] + self.x[i + di, j + dj]
                held = ti.Vector([self.bend[i, j][kind, 0], self.bend[i, j][kind, 1], self.bend[i, j][kind, 2]])
                step = -(c + soft * held) / (before + 4.0 * middle + after + soft)
                for axis in ti.static(range(3)):
                    self.bend[i, j][kind, axis] = held[axis] + step[axis]
                self.x[i - di, j - dj] = self.x[i - di, j - dj] + before * step
                self.x[i, j] = self.x[i, j] - 2.0 * middle * step
                self.x[i + di, j + dj] = self.x[i + di, j + dj] + after * step
        g = self.g[i, j][2]
        if g > 0.0:
            soft = 1.0 / (g * h * h)
            held = ti.Vector([self.bend[i, j][2, 0], self.bend[i, j][2, 1], self.bend[i, j][2, 2]])
            c, weight = soft * held, soft
            for di, dj in ti.static(((0, 0), (0, 1), (1, 0), (1, 1))):
                c += (1.0 if ti.static(di == dj) else -1.0) * self.x[i + di, j + dj]
                weight += self.inverse[i + di, j + dj]
            step = -c / weight
            for axis in ti.static(range(3)):
                self.bend[i, j][2, axis] = held[axis] + step[axis]
            for di, dj in ti.static(((0, 0), (0, 1), (1, 0), (1, 1))):
                sign = 1.0 if ti.static(di == dj) else -1.0
                self.x[i + di, j + dj] = self.x[i + di, j + dj] + sign * self.inverse[i + di, j + dj] * step
