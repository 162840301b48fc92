"""MuJoCo as a peer: a flex whose elasticity stands for the same sheet.

As its documentation recommends for cloth (Modeling, Deformables): ``integrator="discrete"`` and ``solver="Newton"``
with continuum elasticity of a shell; also the quicker edge constraints under ``implicitfast``. A Saint
Venant-Kirchhoff membrane has two constants, a sheet of springs three: the membrane matches the stiffness along the
threads, ``stretch + shear`` [N/m] with its diagonals, and across them, ``shear``; it shears 1.7 times stiffer. Its
thickness gives the same bending stiffness. Masses, drag, damping, pins, radius and friction are ours. The wind is
computed by our NumPy twin once a step and enters as a force; its time is not counted.
"""

from typing import Any

import mujoco
import numpy as np

from cloth_envs.physics.laws.air import air_forces
from cloth_envs.state import State
from training.bench.peers.scenes import Peer, Setup, clock

SOLREF = "0.004 1"  # of contact and of edges: the stiff end of what the documentation recommends


def sheet(setup: Setup) -> tuple[float, float, float]:
    """Young's modulus [Pa], Poisson's ratio and thickness [m] of the shell; ``E t`` and ``E t^3`` are what counts."""
    m = setup.scene.material
    along, across = m.stretch_stiffness + m.shear_stiffness, m.shear_stiffness
    poisson = across / along
    young_thickness = along * (1 - poisson**2)
    thickness = float(np.sqrt(12 * m.bend_stiffness * (1 - poisson**2) / young_thickness))
    return young_thickness / thickness, poisson, thickness


def document(
    setup: Setup, method: str, step: float, *, solver: str = "Newton", iterations: int = 100, passive: bool = False
) -> str:
    """The model as MJCF: ``solver`` and ``iterations`` are those of the constraints, contact is ``passive`` by implicit
    penalty forces without friction.
    """
    scene, grid = setup.scene, setup.scene.grid
    young, poisson, thickness = sheet(setup)
    points = " ".join(f"{value:.9g}" for value in np.moveaxis(setup.rest, 0, -1).ravel())
    elements = " ".join(map(str, grid.triangles.ravel()))
    held = f'<pin id="{" ".join(map(str, scene.handles))}"/>' if scene.handles else ""
    integrator, cloth = "implicitfast", f'<edge equality="true" solref="{SOLREF}"/>'
    if method != "edges":
        integrator, terms = "discrete", {"elastic": "both", "membrane": "stretch"}[method]
        cloth = f'<elasticity young="{young}" poisson="{poisson}" thickness="{thickness}" '
        cloth += f'damping="{scene.material.damping}" elastic2d="{terms}"/>'
    body = scene.colliders[0] if scene.colliders else None
    friction = f'friction="{body.friction} 0 0"' if body else ""
    sphere = f'<geom type="sphere" size="{body.radius}" {friction}/>' if body else ""
    contact = f'<contact selfcollide="none" solref="{SOLREF}" passive="{str(passive).lower()}" {friction}/>'
    flags = f'<flag autoreset="disable" contact="{"enable" if body else "disable"}"/>'
    return f"""<mujoco>
      <option timestep="{step}" integrator="{integrator}" solver="{solver}" iterations="{iterations}"
              tolerance="1e-6" gravity="0 0 {-scene.gravity}">{flags}</option>
      <size memory="1G"/>
      <worldbody>{sphere}
        <flexcomp name="cloth" type="direct" dim="2" radius="{scene.thickness}" mass="{scene.mass.sum()}"
                  point="{points}" element="{elements}">{held}{cloth}{contact}</flexcomp>
      </worldbody></mujoco>"""


class MujocoCloth(Peer):
    """``method``: ``"elastic"`` (stretch and bending), ``"membrane"`` (stretch), ``"edges"`` (constraints)."""

    def __init__(self, setup: Setup, method: str = "elastic", substeps: int = 1, **options: Any) -> None:
        mujoco.set_mju_user_warning(lambda _: None)  # keeps it from writing a log file where it is run
        super().__init__(setup)
        self.substeps = substeps
        scene = setup.scene
        text = document(setup, method, scene.frame_dt / substeps, **options)
        self.model = mujoco.MjModel.from_xml_string(text)
        self.free = ~setup.pins
        self.model.body_mass[1:] = scene.mass[self.free]
        self.model.dof_damping[:] = np.repeat(scene.mass[self.free], 3) * scene.material.drag
        self.data = mujoco.MjData(self.model)
        mujoco.mj_setConst(self.model, self.data)
        self.masses = scene.mass.copy()  # pinned vertices belong to the world and have ours
        self.masses[self.free] = self.model.body_mass[1:]
        self.reset(setup.start)

    def reset(self, state: State, materials: object = None, which: object = None) -> None:
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = (state.positions[0] - self.setup.rest)[:, self.free].T.ravel()
        self.data.qvel[:] = state.velocities[0][:, self.free].T.ravel()

    def run_frame(self, wind: np.ndarray) -> None:
        together = self.substeps if self.scene.air is None else 1
        for _ in range(self.substeps // together):
            if self.scene.air is not None:
                x, v = self.read()
                self.data.qfrc_applied[:] = air_forces(self.scene, x[None], v[None], wind)[0][:, self.free].T.ravel()
            begin = clock()
            mujoco.mj_step(self.model, self.data, together)
            self.taken += clock() - begin

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        x, v = self.setup.rest.copy(), np.zeros_like(self.setup.rest)
        x[:, self.free] += self.data.qpos.reshape(-1, 3).T
        v[:, self.free] = self.data.qvel.reshape(-1, 3).T
        return x, v
