"""Elastic robots by seed alone: how many servos, what they are called, which are mirrored.

Names, limits, kinds of joints and which way they are mounted are drawn; the fit knows
but names, limits and the word for what a positive angle does, as a face's YAML tells them.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from calibration.mouth_servos import JointRange, MouthServos
from calibration.simulated.elastic_family import KINDS, robot_of_kinds
from calibration.simulated.elastic_robot import ElasticDraw
from lipsync.arrays import Array

N_SERVOS = (1, 4, 6, 8, 10, 12)
#: Of the robots with an even number of servos that are drawn most.
_SHARES = (0.08, 0.12, 0.2, 0.25, 0.25, 0.1)
#: Servos that are mounted the other way round than the next builder's.
_MIRRORED = 0.3

#: What says the opposite of a kind's word.
OPPOSITES: Mapping[str, str] = {
    "opens": "closes",
    "raises": "lowers",
    "lowers": "raises",
    "widens": "narrows",
    "protrudes": "retracts",
}
_SETS: Mapping[int, tuple[str, ...]] = {
    1: ("jaw",),
    4: ("jaw", "upper", "lower", "corners"),
    6: ("jaw", "upper", "lower", "out_l", "out_r", "pucker"),
    8: ("jaw", "upper_l", "upper_r", "lower_l", "lower_r", "out_l", "out_r", "pucker"),
    10: (
        "jaw", "upper_l", "upper_r", "lower_l", "lower_r", "out_l", "out_r", "up_l", "up_r",
        "pucker",
    ),
    12: (
        "jaw", "upper_l", "upper_m", "upper_r", "lower_l", "lower_m", "lower_r", "out_l", "out_r",
        "up_l", "up_r", "pucker",
    ),
}  # fmt: skip
#: How builders call such joints.
_NAMES: Mapping[str, tuple[str, ...]] = {
    "jaw": ("mandible", "m1_jaw", "kiefer", "jaw_pitch"),
    "upper": ("top_lip", "m2_top", "oberlippe", "lip_up"),
    "lower": ("bottom_lip", "m3_bottom", "unterlippe", "lip_down"),
    "corners": ("smile", "m4_smile", "winkel", "mouth_wide"),
    "upper_l": ("top_lip_l", "m2", "oberlippe_links", "lip_up_port"),
    "upper_r": ("top_lip_r", "m3", "oberlippe_rechts", "lip_up_starboard"),
    "upper_m": ("top_lip_mid", "m11", "oberlippe_mitte", "lip_up_mid"),
    "lower_l": ("bottom_lip_l", "m4", "unterlippe_links", "lip_down_port"),
    "lower_r": ("bottom_lip_r", "m5", "unterlippe_rechts", "lip_down_starboard"),
    "lower_m": ("bottom_lip_mid", "m12", "unterlippe_mitte", "lip_down_mid"),
    "out_l": ("cheek_l", "m6", "winkel_links", "wide_port"),
    "out_r": ("cheek_r", "m7", "winkel_rechts", "wide_starboard"),
    "up_l": ("smile_l", "m8", "laecheln_links", "smile_port"),
    "up_r": ("smile_r", "m9", "laecheln_rechts", "smile_starboard"),
    "pucker": ("kiss", "m10", "kuss", "pucker"),
}


def draw_elastic_robot(
    rest_mm: Array, seed: int, n_servos: int | None = None
) -> tuple[ElasticDraw, MouthServos]:
    """Return an elastic robot drawn by a seed, and what its face's YAML would say of it.

    Parameters
    ----------
    rest_mm : Array
        (47, 3), a closed mouth.
    seed : int
        Of the draw.
    n_servos : int | None
        One of N_SERVOS; None: drawn too.

    Returns
    -------
    tuple[ElasticDraw, MouthServos]
        The robot, lengths in mm; names, limits in degrees and directions of its servos.
    """
    rng = np.random.default_rng([seed, 17])
    n_drawn = int(rng.choice(N_SERVOS, p=_SHARES))
    kinds = _SETS[n_servos or n_drawn]
    names = tuple(_NAMES[kind][int(seed) % 4] for kind in kinds)
    draw, limits_deg = robot_of_kinds(rest_mm, kinds, names, rng)
    # Of a generator of its own: all else of a seed is as if no servo were mirrored.
    is_mirrored = np.random.default_rng([seed, 31]).random(len(kinds)) < _MIRRORED
    joints, direction_words = [], []
    for name, kind, limits, mirrored in zip(names, kinds, limits_deg, is_mirrored, strict=True):
        min_deg, max_deg = (-limits[1], -limits[0]) if mirrored else limits
        joints.append(JointRange(name, float(min_deg), float(max_deg)))
        word = KINDS[kind].word
        direction_words.append(OPPOSITES[word] if mirrored else word)
    servos = MouthServos(tuple(joints), f"elastic-{seed}", (), tuple(direction_words))
    return replace(draw, signs=np.where(is_mirrored, -1.0, 1.0)), servos
