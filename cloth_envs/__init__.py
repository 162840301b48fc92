"""MiniCloth: cloth scenes as Gymnasium environments with pluggable physics.

Importing the package registers ``MiniCloth-<Scene>-v0`` and ``-v1`` for every scene.
"""

import warnings

from gymnasium.envs.registration import register

from cloth_envs.material import FABRICS, Material
from cloth_envs.registry import BACKENDS, EPISODE_FRAMES, SCENES, env_id, register_backend
from cloth_envs.scene import Air, Collider, Scene, SelfContact
from cloth_envs.state import Controls, State
from cloth_envs.version import __version__

__all__ = [
    "BACKENDS",
    "FABRICS",
    "SCENES",
    "Air",
    "Collider",
    "Controls",
    "Material",
    "Scene",
    "SelfContact",
    "State",
    "__version__",
    "env_id",
    "register_backend",
]

for _name, _frames in EPISODE_FRAMES.items():
    register(
        id=env_id(_name),
        entry_point="cloth_envs.env:ClothEnv",
        vector_entry_point="cloth_envs.vector_env:ClothVectorEnv",
        kwargs={"scene": _name},
        max_episode_steps=_frames,
    )

# Gymnasium warns of every id that has a later version; here both are kept.
warnings.filterwarnings("ignore", r".*MiniCloth-.*-v0 is out of date", DeprecationWarning)
