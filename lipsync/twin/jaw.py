"""The lower teeth: a jaw of three degrees of freedom, linear, fitted to the motion of the chin."""

import numpy as np

from lipsync.arrays import Array


def jaw_motion(chin_mm: Array, joint_mm: Array, chin_moves_mm: Array) -> Array:
    """Opening, forward and sideways motion that explain best how the chin moves.

    chin_mm (n, 3), joint_mm (3,): where they are; chin_moves_mm (n_morphs, n, 3).
    Returns (n_morphs, 3): radians about the joint (positive opens), mm forward, mm to +x.
    """
    columns = jaw_modes(chin_mm, joint_mm).transpose(1, 2, 0).reshape(-1, 3)
    solved, *_ = np.linalg.lstsq(columns, chin_moves_mm.reshape(len(chin_moves_mm), -1).T)
    return np.asarray(solved.T, dtype=np.float64)


def jaw_modes(places_mm: Array, joint_mm: Array) -> Array:
    """(3, n, 3): what 1 rad of opening, 1 mm forward and 1 mm sideways do to places of the jaw."""
    from_joint = places_mm - joint_mm
    modes = np.zeros((3, *places_mm.shape))
    # A small rotation about +x takes z into y's place: (0, -z, y); the chin goes down and back.
    modes[0, :, 1] = -from_joint[:, 2]
    modes[0, :, 2] = from_joint[:, 1]
    modes[1, :, 2] = 1.0
    modes[2, :, 0] = 1.0
    return modes


def on_jaw(places_mm: Array, joint_mm: Array, motion: Array) -> Array:
    """(n_morphs, n, 3): displacements of places on the jaw; `motion` is of `jaw_motion`."""
    return np.asarray(
        np.einsum("kj,jni->kni", motion, jaw_modes(places_mm, joint_mm)), dtype=np.float64
    )
