"""How fast the lips go from one tick of 10 ms to the next: steps that 25 frames a second hide.

Of recorded lips (grid_s1, 25 Hz) 99 % of frames are below 200 mm/s and none is above 310.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from lipsync.arrays import Array
from lipsync.face.model import FaceModel
from lipsync.motion.tick_plan import TICK_S

#: No lip that was recorded goes so fast.
STEP_MM_S = 400.0


@dataclass(frozen=True, slots=True)
class LipSpeed:
    """Of one piece of motion. n_steps: ticks in which a point of the lips is above STEP_MM_S."""

    fastest_mm_s: float
    n_steps: int
    spoken_s: float


def lip_speed(model: FaceModel, faces: Array, spoken_s: float) -> LipSpeed:
    """The speed of the fastest point of the lips in faces (n, n_components), one a tick.

    spoken_s: how much of the time somebody speaks, which the steps are counted by.
    """
    lips_mm = model.markers_mm(faces)[:, list(model.layout.lips)]
    fastest = np.linalg.norm(np.diff(lips_mm, axis=0), axis=2).max(axis=1, initial=0.0) / TICK_S
    return LipSpeed(
        float(fastest.max(initial=0.0)), int(np.count_nonzero(fastest > STEP_MM_S)), spoken_s
    )


def lip_speed_figures(speeds: Iterable[LipSpeed]) -> dict[str, float | None]:
    """Of many pieces together; steps are None where nobody speaks."""
    found = list(speeds)
    spoken_s = sum(one.spoken_s for one in found)
    n_steps = sum(one.n_steps for one in found)
    return {
        "fastest_lip_mm_s": max((one.fastest_mm_s for one in found), default=0.0),
        "fast_steps_per_s": n_steps / spoken_s if spoken_s else None,
    }
