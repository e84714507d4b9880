"""Elastic robots by seed: how many servos, what they are called, where they pull, how weak.

Names, limits, kinds of joints and which way they are mounted are drawn; none is told to what fits
but names, limits and the word for what a positive angle does, as a face's YAML tells them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from calibration.joint_range import JointRange
from calibration.mouth_servos import MouthServos
from calibration.simulated.elastic_robot import ElasticDraw, Rod
from calibration.simulated.elastic_skin import N_PAIRS, ElasticSkin, elastic_skin
from calibration.simulated.four_bar import FourBar
from calibration.simulated.pull_kinds import KINDS, OPPOSITES, pulls_of
from lipsync.arrays import Array
from lipsync.markers import MARKERS_47

N_SERVOS = (1, 4, 6, 8, 10, 12)
#: Of the robots with an even number of servos that are drawn most.
_SHARES = (0.08, 0.12, 0.2, 0.25, 0.25, 0.1)
_WEAK_LEFT = 0.7
_DOTS_MM, _NEUTRAL_GAP_MM, _PLAY_DEG = (0.0, 1.5), (0.0, 0.8), (0.8, 1.2)
_SIZE, _ARM_MM, _ROD_N_PER_MM = (0.88, 1.15), (8.0, 12.0), (4.0, 12.0)
_SAG_DEG, _DRIFT_DEG, _ZERO_DEG = (0.0, 0.5), 0.3, 1.0
#: The jaw and its servo give way by a degree to so many newton-millimetres.
_JAW_NMM_PER_DEG = (300.0, 900.0)
_BEHIND_MM, _ABOVE_MM = 85.0, 36.0
#: Servos that are mounted the other way round than the next builder's.
_MIRRORED = 0.3


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
    """The robot of a seed, and what its face YAML says. rest_mm: (47, 3), a closed mouth.

    n_servos: one of N_SERVOS, where not the seed decides.
    """
    rng = np.random.default_rng([seed, 17])
    drawn = int(rng.choice(N_SERVOS, p=_SHARES))
    kinds = _SETS[n_servos or drawn]
    names = tuple(_NAMES[kind][int(seed) % 4] for kind in kinds)
    draw, limits_deg = _drawn(rest_mm, kinds, names, rng)
    # Of a generator of its own: all else of a seed is as if no servo were mirrored.
    is_mirrored = np.random.default_rng([seed, 31]).random(len(kinds)) < _MIRRORED
    joints, words = [], []
    for name, kind, limits, mirrored in zip(names, kinds, limits_deg, is_mirrored, strict=True):
        low, high = (-limits[1], -limits[0]) if mirrored else limits
        joints.append(JointRange(name, float(low), float(high)))
        word = KINDS[kind].word
        words.append(OPPOSITES[word] if mirrored else word)
    servos = MouthServos(tuple(joints), f"elastic-{seed}", (), tuple(words))
    return replace(draw, signs=np.where(is_mirrored, -1.0, 1.0)), servos


def elastic_robot_of(rest_mm: Array, servos: MouthServos, seed: int) -> ElasticDraw:
    """A robot of a seed that is built as a face's YAML says: its joints, by their names and words.

    rest_mm: (47, 3), a closed mouth. What the YAML leaves open pull_kinds.py says.
    """
    pulls = pulls_of(servos.names, servos.positive)
    kinds = [pull.kind for pull in pulls]
    draw, _ = _drawn(rest_mm, kinds, servos.names, np.random.default_rng([seed, 37]))
    signs = np.array([float(pull.sign) for pull in pulls])
    four_bar = draw.four_bar
    if draw.jaw >= 0:
        limits_deg = signs[draw.jaw] * np.array(servos.limits_deg)[:, draw.jaw]
        if not four_bar.can_turn(limits_deg):
            # A parallelogram turns the jaw as far as the servo, and by a straight line.
            four_bar = replace(four_bar, rocker_mm=four_bar.crank_mm, rod_mm=four_bar.ground_mm)
    return replace(draw, signs=signs, four_bar=four_bar)


def _drawn(
    rest_mm: Array, kinds: Sequence[str], names: tuple[str, ...], rng: np.random.Generator
) -> tuple[ElasticDraw, Array]:
    """A robot of these kinds of joints, none mounted mirrored, and its limits (n_servos, 2)."""
    middle_mm = rest_mm.mean(axis=0)
    rest_mm = middle_mm + (rest_mm - middle_mm) * rng.uniform(*_SIZE, size=3)
    bow = np.sin(np.linspace(0.0, np.pi, N_PAIRS + 2)[1:-1])
    off_edge_mm = np.maximum(rng.uniform(*_DOTS_MM) + rng.normal(0.0, 0.15, 6), 0.0)
    skin = elastic_skin(rest_mm, rng.uniform(*_NEUTRAL_GAP_MM) * bow, off_edge_mm)
    seam_mm = (rest_mm[MARKERS_47.upper_lip] + rest_mm[MARKERS_47.lower_lip]) / 2
    axis_mm = seam_mm + np.array([0.0, _ABOVE_MM, -_BEHIND_MM]) + rng.normal(0.0, 5.0, 3)
    rods = tuple(
        rod for joint, kind in enumerate(kinds) for rod in _rods(joint, kind, rest_mm, skin, rng)
    )
    n = len(kinds)
    limits_deg = np.array(
        [np.round(np.array(KINDS[kind].limits_deg) * rng.uniform(0.85, 1.1)) for kind in kinds]
    )
    is_jaw = np.array([kind == "jaw" for kind in kinds])
    draw = ElasticDraw(
        servo_names=names,
        skin=skin,
        rods=rods,
        jaw=int(is_jaw.argmax()) if is_jaw.any() else -1,
        four_bar=_four_bar(rng),
        axis_mm=axis_mm,
        sag_deg=float(rng.uniform(*_SAG_DEG)),
        jaw_rad_per_nmm=float(np.deg2rad(1.0) / rng.uniform(*_JAW_NMM_PER_DEG)),
        signs=np.ones(n),
        zero_deg=rng.normal(0.0, np.where(is_jaw, _ZERO_DEG / 4, _ZERO_DEG)),
        play_deg=rng.uniform(*_PLAY_DEG, size=n),
        drift_deg=rng.normal(0.0, np.where(is_jaw, _DRIFT_DEG / 3, _DRIFT_DEG)),
    )
    return draw, limits_deg


def _rods(
    joint: int, kind: str, rest_mm: Array, skin: ElasticSkin, rng: np.random.Generator
) -> list[Rod]:
    """A horn for each place that the joint pulls at; those on the left are weak."""
    of = KINDS[kind]
    arm_mm = rng.uniform(*_ARM_MM) * (0.6 if kind == "pucker" else 1.0)
    stiff, bend = rng.uniform(*_ROD_N_PER_MM), np.tan(np.deg2rad(8.0)) * rng.normal(size=3)
    rods = []
    for landmark, direction in of.pulls:
        place_mm = rest_mm[MARKERS_47.landmarks.index(landmark)]
        along = np.array(direction) + bend
        along /= np.linalg.norm(along)
        over = np.array([0.0, 0.0, -1.0]) if abs(along[2]) < 0.8 else np.array([0.0, -1.0, 0.0])
        over = over - (over @ along) * along
        weak = _WEAK_LEFT if place_mm[0] > rest_mm[MARKERS_47.landmarks.index(0), 0] + 5.0 else 1.0
        rods.append(
            Rod(
                joint=joint,
                patch=skin.patch(place_mm, None if of.lip == 0 else of.lip < 0),
                place_mm=place_mm,
                along=along,
                over=over / np.linalg.norm(over),
                arm_mm=weak * arm_mm,
                n_per_mm=stiff,
                rides={-1: 1.0, 0: 0.5, 1: 0.0}[of.lip],
            )
        )
    return rods


def _four_bar(rng: np.random.Generator) -> FourBar:
    """Jaw over servo about 1 in the middle, from 0.2 to several times that at the ends."""
    crank_mm = rng.uniform(16.0, 22.0)
    return FourBar(
        crank_mm=crank_mm,
        rod_mm=rng.uniform(38.0, 48.0),
        rocker_mm=crank_mm * rng.uniform(0.95, 1.25),
        ground_mm=rng.uniform(40.0, 46.0),
        start_deg=rng.uniform(60.0, 95.0),
    )
