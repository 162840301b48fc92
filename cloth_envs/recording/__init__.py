"""Rollouts on disk: HDF5 as The Well reads it (Ohana et al. 2024), safe from killed writers, replayed bit for bit.

Layout, version 3; N trajectories of at most T frames on an H x W grid, A actions, C bodies::

    /                    @layout_version @scene @env_spec @env_spec_left_out @wrappers @package_version @units @dt [s]
                         @n_trajectories ...; texts are JSON where they have structure
    dimensions/          time (N, T) [s], row (H) and col (W) [m] along the flat cloth
    t0_fields/           position_x, _y, _z, velocity_x, _y, _z: (N, T, H, W) [m], [m/s], in the state's own dtype
    scalars/             reward, pressure [Pa]: (N, T); every property of the material: (N)
    boundary_conditions/ handles: mask (H, W), vertices; closed: only where the cloth is a tube
    colliders/           positions, velocities (N, T, C, 2, 3), the same; kinds, radii, frictions are in @scene
    actions (N, T, A)    wind (N, T, 3) [m/s]    frames (N): how many of each trajectory are whole; later ones are NaN
    seeds (N, words)     in words of 64 bits, the lowest first
    began (N)            1 by a reset, 3 by one with a seed, 0 where the state was changed in the middle of an episode
    starts/<n>           what ``get_state`` gave where trajectory n began, as the bytes of a ``.npz`` file
    commits              how often the writer has written

Every dataset has ``@units``, every one that grows a checksum. Positions are six scalar fields since The Well gives a
vector as many components as the grid has dimensions: two, on a sheet. All other numbers are float64. Layouts 1 and 2
had ``t1_fields`` positions and velocities ``(N, T, H, W, 3)`` and no starts; 1 had float32 everywhere but in ``time``
and the material. Both still read.

Frame 0 is the start, its action and reward are 0; action t led to frame t. Recorded is what the unwrapped environment
took and gave: ``env.unwrapped.set_state(rollout.start(n))``, or a reset to the seed, and the actions give the frames
and rewards again.

Beyond HDF5's end of the file are checksums of all its pages (``pages``), which ``Rollout`` verifies before HDF5 sees a
byte (``stored``). Frames are written in chunks, each whole or not at all (``image``): a killed writer, or one whose
disk is full, loses the chunk it was filling. A new file has its own name from the start; one that replaces another
(``overwrite=True``) is ``<name>.part`` until it is closed, and stays that where its writer was killed. Others may read
meanwhile. Nothing is compressed: measured on a flag, gzip saved 18 % of the space for 15 times the writing time. Cloth
that is rounded (``RolloutWriter(steps=)``), of which it saves more, is.
"""

from cloth_envs.recording.reader import Rollout
from cloth_envs.recording.recorder import RecordRollout
from cloth_envs.recording.writer import RolloutWriter

__all__ = ["RecordRollout", "Rollout", "RolloutWriter"]
