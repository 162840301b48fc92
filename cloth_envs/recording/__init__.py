"""Rollouts on disk: HDF5 in the layout of The Well (Ohana et al. 2024), readable after a killed writer.

Layout, version 2; N trajectories of at most T frames on an H x W grid, A actions, C bodies::

    /                    @layout_version @scene @env_spec @package_version @units @n_trajectories ... (JSON texts)
    dimensions/          time (N, T) [s], row (H) and col (W) [m] along the flat cloth
    t1_fields/           positions, velocities: (N, T, H, W, 3) [m], [m/s], in the state's own dtype
    scalars/             reward, pressure [Pa]: (N, T); every property of the material: (N)
    boundary_conditions/ handles: mask (H, W), vertices; closed: only where the cloth is a tube
    colliders/           positions, velocities (N, T, C, 2, 3), the same; kinds, radii, frictions are in @scene
    actions (N, T, A)    wind (N, T, 3) [m/s]    seeds (N), -1 where none was given
    frames (N)           how many frames of each trajectory are whole; later entries are NaN

All other numbers are float64, so that a file holds what was used: seed and actions give the same frames again, bit for
bit. Version 1 had float32 everywhere but in ``time`` and the material; it still reads.

Frame 0 is the start, its action and reward are 0; action t led to frame t. Frames are written in chunks and
flushed in HDF5's single-writer mode, ``frames`` last: a killed writer loses at most the chunk it was filling.
Nothing is compressed: measured on a flag, gzip saved 18 % of the space for 15 times the writing time.
"""

from cloth_envs.recording.reader import Rollout
from cloth_envs.recording.recorder import RecordRollout
from cloth_envs.recording.writer import RolloutWriter

__all__ = ["RecordRollout", "Rollout", "RolloutWriter"]
