"""Elastic robots built from a face's YAML: the joints' pulls, ranges and weaknesses.

The joints' names and the words for their positive angles define the robot; what they leave open is
distributed over the parts of the mouth without a joint. All else is drawn from a seed, and none of
it is known to the fit.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.joint_motion import CLOSE, DOWN, UP, Channel, JointMotion, joint_motion, words
from calibration.mouth_servos import MouthServos
from calibration.simulated.elastic_robot import (
    N_PAIRS,
    ElasticDraw,
    ElasticSkin,
    FourBar,
    Rod,
    elastic_skin,
)
from lipsync.arrays import Array
from lipsync.markers import MARKERS_47


@dataclass(frozen=True, slots=True)
class PullKind:
    """A kind of joint, by what it pulls at. word: for its positive angle; lip: that it moves.

    pulls: landmark and direction of each rod; limits_deg: usual limits.
    """

    word: str
    pulls: tuple[tuple[int, tuple[float, float, float]], ...]
    limits_deg: tuple[float, float]
    lip: int = 0
    """1 upper, -1 lower, 0 neither."""


_OUT = (0.9, 0.0, -0.44)
_IN = (-0.9, 0.0, -0.44)
_UP, _DOWN, _FORWARD = (0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)
KINDS: Mapping[str, PullKind] = {
    "jaw": PullKind("opens", (), (-3.0, 24.0)),
    "upper": PullKind("raises", ((39, _UP), (269, _UP), (0, _UP)), (-35.0, 35.0), 1),
    "lower": PullKind("lowers", ((181, _DOWN), (405, _DOWN), (17, _DOWN)), (-35.0, 35.0), -1),
    "corners": PullKind("widens", ((61, _IN), (291, _OUT)), (-30.0, 35.0)),
    "upper_l": PullKind("raises", ((269, _UP),), (-35.0, 35.0), 1),
    "upper_r": PullKind("raises", ((39, _UP),), (-35.0, 35.0), 1),
    "upper_m": PullKind("raises", ((0, _UP),), (-30.0, 30.0), 1),
    "lower_l": PullKind("lowers", ((405, _DOWN),), (-35.0, 38.0), -1),
    "lower_r": PullKind("lowers", ((181, _DOWN),), (-35.0, 38.0), -1),
    "lower_m": PullKind("lowers", ((17, _DOWN),), (-30.0, 30.0), -1),
    "out_l": PullKind("widens", ((291, _OUT),), (-30.0, 35.0)),
    "out_r": PullKind("widens", ((61, _IN),), (-30.0, 35.0)),
    "smile": PullKind("raises", ((291, _UP), (61, _UP)), (-30.0, 30.0)),
    "up_l": PullKind("raises", ((291, _UP),), (-30.0, 30.0)),
    "up_r": PullKind("raises", ((61, _UP),), (-30.0, 30.0)),
    "pucker": PullKind(
        "protrudes", ((0, _FORWARD), (17, _FORWARD), (39, _FORWARD), (269, _FORWARD)), (-20.0, 40.0)
    ),
}

#: By side: left, right, middle, both.
_KIND_OF_CHANNEL: Mapping[Channel, tuple[str, str, str, str]] = {
    "jaw": ("jaw", "jaw", "jaw", "jaw"),
    "upper_lip": ("upper_l", "upper_r", "upper_m", "upper"),
    "lower_lip": ("lower_l", "lower_r", "lower_m", "lower"),
    "corner_out": ("out_l", "out_r", "corners", "corners"),
    "corner_up": ("up_l", "up_r", "smile", "smile"),
    "protrusion": ("pucker", "pucker", "pucker", "pucker"),
}
_SIDES = ("left", "right", "middle", "both")
#: Several of one channel whose names tell no side share these out.
_KINDS_TO_SHARE: Mapping[Channel, tuple[str, ...]] = {
    "upper_lip": ("upper_l", "upper_r", "up_l", "up_r", "upper_m"),
    "lower_lip": ("lower_l", "lower_r", "lower_m"),
    "corner_out": ("out_l", "out_r"),
    "corner_up": ("up_l", "up_r"),
}
#: For joints of which nothing is known.
_GUESSED_KINDS = ("upper", "lower", "corners", "pucker", "smile")


@dataclass(frozen=True, slots=True)
class Pull:
    """The kind of pull of one joint of a face, a key of `KINDS`.

    sign: -1 where a positive angle pulls oppositely; is_guess: whether name and word leave open
    what the joint moves.
    """

    kind: str
    sign: int
    is_guess: bool = False


def pulls_of(names: Sequence[str], positive: Sequence[str]) -> tuple[Pull, ...]:
    """Return the pull of each joint of a mouth by its name and word, guessed if these do not tell.

    positive: one word per joint, or empty. The first joint that opens is the jaw. Two joints may
    pull at one landmark.
    """
    positives = positive or [""] * len(names)
    # The motion by name and word; else by the word alone, a guess.
    by_name = [joint_motion(name, word) for name, word in zip(names, positives, strict=True)]
    motions = [motion or _lip_motion(word) for motion, word in zip(by_name, positives, strict=True)]
    kinds_taken: list[str] = []
    pulls = []
    for motion, named_motion in zip(motions, by_name, strict=True):
        kind = _kind_of(motion, motions, kinds_taken)
        kinds_taken.append(kind)
        pulls.append(Pull(kind, 1 if motion is None else motion.sign, named_motion is None))
    return tuple(pulls)


def _lip_motion(word: str) -> JointMotion | None:
    """Return the lip motion for a word of direction: upper for up, lower for down; else None."""
    word_parts = words(word)
    if bool(word_parts & UP) == bool(word_parts & (DOWN | CLOSE)):
        return None
    return JointMotion("upper_lip" if word_parts & UP else "lower_lip", "both", 1)


def _kind_of(
    motion: JointMotion | None, all_motions: Sequence[JointMotion | None], taken: list[str]
) -> str:
    """Return the kind of pull, a key of `KINDS`, for a joint's motion; None: not known.

    all_motions: of all joints; taken: kinds given to the joints before. A kind not taken is guessed
    for an unknown motion, and where several joints of one channel name no side.
    """
    if motion is None:
        free_kinds = [kind for kind in _GUESSED_KINDS if kind not in taken]
        return free_kinds[0] if free_kinds else _GUESSED_KINDS[len(taken) % len(_GUESSED_KINDS)]
    if motion.channel == "jaw" and "jaw" in taken:
        return "lower"
    if motion.side == "both" and motion.channel in _KINDS_TO_SHARE:
        same_channel = [each for each in all_motions if each and each.channel == motion.channel]
        free_kinds = [kind for kind in _KINDS_TO_SHARE[motion.channel] if kind not in taken]
        if len(same_channel) > 1 and free_kinds:
            return free_kinds[0]
    return _KIND_OF_CHANNEL[motion.channel][_SIDES.index(motion.side)]


_WEAK_LEFT = 0.7
_DOTS_MM, _NEUTRAL_GAP_MM, _PLAY_DEG = (0.0, 1.5), (0.0, 0.8), (0.8, 1.2)
_SIZE, _ARM_MM, _ROD_N_PER_MM = (0.88, 1.15), (8.0, 12.0), (4.0, 12.0)
_SAG_DEG, _DRIFT_DEG, _ZERO_DEG = (0.0, 0.5), 0.3, 1.0
#: The jaw and its servo give way by a degree to so many newton-millimetres.
_JAW_NMM_PER_DEG = (300.0, 900.0)
_BEHIND_MM, _ABOVE_MM = 85.0, 36.0


def elastic_robot_of(rest_mm: Array, servos: MouthServos, seed: int) -> ElasticDraw:
    """Return an elastic robot with the joints of a face's YAML, the rest drawn from a seed.

    Joints that names and words leave open are guessed.

    Parameters
    ----------
    rest_mm : Array
        (47, 3) mm, markers of a closed mouth.
    servos : MouthServos
        Servos of the face's YAML.
    seed : int
        Seed of the draw.

    Returns
    -------
    ElasticDraw
        The drawn robot, lengths in mm.
    """
    pulls = pulls_of(servos.names, servos.positive)
    kinds = [pull.kind for pull in pulls]
    draw, _ = robot_of_kinds(rest_mm, kinds, servos.names, np.random.default_rng([seed, 37]))
    signs = np.array([float(pull.sign) for pull in pulls])
    four_bar = draw.four_bar
    if draw.jaw >= 0:
        limits_deg = signs[draw.jaw] * np.array(servos.limits_deg)[:, draw.jaw]
        if not four_bar.can_turn(limits_deg):
            # A parallelogram turns the jaw as far as the servo, and by a straight line.
            four_bar = replace(four_bar, rocker_mm=four_bar.crank_mm, rod_mm=four_bar.ground_mm)
    return replace(draw, signs=signs, four_bar=four_bar)


def robot_of_kinds(
    rest_mm: Array, kinds: Sequence[str], names: tuple[str, ...], rng: np.random.Generator
) -> tuple[ElasticDraw, Array]:
    """Return a robot with joints of these kinds, none mounted mirrored, and its limits.

    Parameters
    ----------
    rest_mm : Array
        (47, 3) mm, markers of a closed mouth.
    kinds : Sequence[str]
        Kind of each joint, a key of `KINDS`.
    names : tuple[str, ...]
        Names of the servos.
    rng : np.random.Generator
        Source of all random values.

    Returns
    -------
    tuple[ElasticDraw, Array]
        The robot, and its limits (n_servos, 2) in degrees.
    """
    middle_mm = rest_mm.mean(axis=0)
    rest_mm = middle_mm + (rest_mm - middle_mm) * rng.uniform(*_SIZE, size=3)
    # The gap between open lips is widest in the middle and 0 at the corners.
    arch = np.sin(np.linspace(0.0, np.pi, N_PAIRS + 2)[1:-1])
    off_edge_mm = np.maximum(rng.uniform(*_DOTS_MM) + rng.normal(0.0, 0.15, 6), 0.0)
    skin = elastic_skin(rest_mm, rng.uniform(*_NEUTRAL_GAP_MM) * arch, off_edge_mm)
    seam_mm = (rest_mm[MARKERS_47.upper_lip] + rest_mm[MARKERS_47.lower_lip]) / 2
    # The jaw's hinge lies behind and above the middle between the lips.
    axis_mm = seam_mm + np.array([0.0, _ABOVE_MM, -_BEHIND_MM]) + rng.normal(0.0, 5.0, 3)
    rods = tuple(
        rod for joint, kind in enumerate(kinds) for rod in _rods_of(joint, kind, rest_mm, skin, rng)
    )
    n_servos = len(kinds)
    limits_deg = np.array(
        [np.round(np.array(KINDS[kind].limits_deg) * rng.uniform(0.85, 1.1)) for kind in kinds]
    )
    is_jaw = np.array([kind == "jaw" for kind in kinds])
    draw = ElasticDraw(
        servo_names=names,
        skin=skin,
        rods=rods,
        jaw=int(is_jaw.argmax()) if is_jaw.any() else -1,
        four_bar=_draw_four_bar(rng),
        axis_mm=axis_mm,
        sag_deg=float(rng.uniform(*_SAG_DEG)),
        jaw_rad_per_nmm=float(np.deg2rad(1.0) / rng.uniform(*_JAW_NMM_PER_DEG)),
        signs=np.ones(n_servos),
        zero_deg=rng.normal(0.0, np.where(is_jaw, _ZERO_DEG / 4, _ZERO_DEG)),
        play_deg=rng.uniform(*_PLAY_DEG, size=n_servos),
        drift_deg=rng.normal(0.0, np.where(is_jaw, _DRIFT_DEG / 3, _DRIFT_DEG)),
    )
    return draw, limits_deg


def _rods_of(
    joint: int, kind: str, rest_mm: Array, skin: ElasticSkin, rng: np.random.Generator
) -> list[Rod]:
    """Return a rod for each landmark that the joint pulls at; rods on the left are weak.

    joint: its number; kind: a key of `KINDS`; stiffness and directions are drawn from `rng`.
    """
    pull_kind = KINDS[kind]
    arm_mm = rng.uniform(*_ARM_MM) * (0.6 if kind == "pucker" else 1.0)
    n_per_mm, tilt = rng.uniform(*_ROD_N_PER_MM), np.tan(np.deg2rad(8.0)) * rng.normal(size=3)
    rods = []
    for landmark, direction in pull_kind.pulls:
        place_mm = rest_mm[MARKERS_47.landmarks.index(landmark)]
        # The direction of the pull, tilted a little; `across` is perpendicular, towards the skull
        # or down.
        along = np.array(direction) + tilt
        along /= np.linalg.norm(along)
        across = np.array([0.0, 0.0, -1.0]) if abs(along[2]) < 0.8 else np.array([0.0, -1.0, 0.0])
        across = across - (across @ along) * along
        weak = _WEAK_LEFT if place_mm[0] > rest_mm[MARKERS_47.landmarks.index(0), 0] + 5.0 else 1.0
        rods.append(
            Rod(
                joint=joint,
                patch=skin.patch(place_mm, None if pull_kind.lip == 0 else pull_kind.lip < 0),
                place_mm=place_mm,
                along=along,
                over=across / np.linalg.norm(across),
                arm_mm=weak * arm_mm,
                n_per_mm=n_per_mm,
                rides={-1: 1.0, 0: 0.5, 1: 0.0}[pull_kind.lip],
            )
        )
    return rods


def _draw_four_bar(rng: np.random.Generator) -> FourBar:
    """Return a linkage of random lengths from servo to jaw.

    Degrees of the jaw per degree of the servo: about 1 in the middle, 0.2 to several at the ends.
    """
    crank_mm = rng.uniform(16.0, 22.0)
    return FourBar(
        crank_mm=crank_mm,
        rod_mm=rng.uniform(38.0, 48.0),
        rocker_mm=crank_mm * rng.uniform(0.95, 1.25),
        ground_mm=rng.uniform(40.0, 46.0),
        start_deg=rng.uniform(60.0, 95.0),
    )
