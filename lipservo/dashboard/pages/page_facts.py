"""Facts of a face for all pages: limits of its servos, what they move, and phoneme colours."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Final, Literal

from calibration.joint_motion import CLOSE, DOWN, OPEN, UP, joint_motion, side_of, words
from lipservo.runtime.servos.assembly import load_settings
from lipservo.settings.settings import FaceSettings, ServoSettings
from lipsync.phonemes import PHONEMES, SILENCE, VISEME_OF

#: Motions of the robot's drawing. The positive direction of each, which `RigServo.sign` refers to:
#: jaw opens; upper_lip raises; lower_lip lowers; corner_out widens; corner_up raises; protrusion
#: protrudes; neck_yaw and eye_yaw to the robot's own left; neck_pitch and eye_pitch up; neck_roll
#: towards its left shoulder; lid opens; brow raises.
Channel = Literal[
    "jaw", "upper_lip", "lower_lip", "corner_out", "corner_up", "protrusion",
    "neck_yaw", "neck_pitch", "neck_roll", "eye_yaw", "eye_pitch", "lid", "brow",
]  # fmt: skip
Side = Literal["left", "right", "both"]

_LEFT, _RIGHT = frozenset({"left"}), frozenset({"right"})
#: Groups of phonemes by what is seen on the lips: a word for the legend, colours of a phoneme's
#: block and of its letters (contrast 4.5 to 1 at least), viseme classes by their first phoneme.
GROUPS: Final = {
    "closed": ("lips shut", "#9b2c3d", "#ffffff", ("P",)),
    "bitten": ("lip to teeth", "#b0561a", "#ffffff", ("F",)),
    "round": ("rounded", "#6b4fa0", "#ffffff", ("W", "AO", "UW", "SH", "ER", "R")),
    "open": ("open", "#12655c", "#ffffff", ("AA", "EH", "HH")),
    "spread": ("spread", "#1f5f99", "#ffffff", ("IY",)),
    "inside": ("made inside", "#dbe2e8", "#24313d", ("TH", "T", "K")),
}


@dataclass(frozen=True, slots=True)
class _Rule:
    """A rule that finds the channel (motion) of the robot's drawing for a servo.

    part: the servo's part. named: sets of words; the servo's name must have a word of each. plus,
    minus: words of the servo's setting `positive` that mean the channel's positive direction, or
    the opposite one.
    """

    part: str
    channel: Channel
    named: tuple[frozenset[str], ...]
    plus: frozenset[str]
    minus: frozenset[str]


def _any(*words: str) -> frozenset[str]:
    return frozenset(words)


_YAW, _PITCH, _ROLL = _any("yaw", "pan", "turn"), _any("pitch", "nod", "tilt"), _any("roll")
#: The first rule that fits counts.
_RULES: Final = (
    _Rule("neck", "neck_yaw", (_YAW,), _LEFT, _RIGHT),
    _Rule("neck", "neck_pitch", (_PITCH,), UP, DOWN),
    _Rule("neck", "neck_roll", (_ROLL,), _LEFT, _RIGHT),
    _Rule("eyes", "eye_yaw", (_YAW,), _LEFT, _RIGHT),
    _Rule("eyes", "eye_pitch", (_PITCH,), UP, DOWN),
    _Rule("lids", "lid", (), OPEN | UP, CLOSE | DOWN),
    _Rule("brows", "brow", (), UP, DOWN),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class RigServo:
    """What a servo moves in the robot's drawing, its rig.

    channel: the drawing's motion; None: not known, the servo is drawn as a dial. side: of the face
    that moves. sign: -1 where a positive angle moves the drawing in its negative direction.
    """

    channel: Channel | None
    side: Side
    sign: Literal[1, -1]


def robot_rig(servos: Mapping[str, ServoSettings]) -> dict[str, RigServo]:
    """Return what each servo moves in the robot's drawing, by name.

    Where two servos would move the same channel and side, only the first gets it; the other has no
    channel, and is drawn as a dial.
    """
    taken: dict[Channel, set[Side]] = {}
    rig = {}
    for name, settings in servos.items():
        motion = _servo_motion(name, settings)
        if motion.channel is not None:
            sides = taken.setdefault(motion.channel, set())
            if motion.side in sides or "both" in sides or (sides and motion.side == "both"):
                motion = RigServo(None, motion.side, 1)
            else:
                sides.add(motion.side)
        rig[name] = motion
    return rig


def _servo_motion(name: str, settings: ServoSettings) -> RigServo:
    """Return what a servo moves in the drawing, by its part, its name and its setting `positive`.

    The channel is None if they name no known motion, or its direction is not clear.
    """
    named_side = side_of(name)
    # What moves the middle is drawn on both sides.
    side: Side = "both" if named_side == "middle" else named_side
    if settings.part == "mouth":
        motion = joint_motion(name, settings.positive)
        if motion is None:
            return RigServo(None, side, 1)
        return RigServo(motion.channel, side, motion.sign)
    name_words, positive_words = words(name), words(settings.positive)
    for rule in _RULES:
        if rule.part != settings.part or not all(name_words & each for each in rule.named):
            continue
        plus, minus = bool(positive_words & rule.plus), bool(positive_words & rule.minus)
        if plus != minus:
            return RigServo(rule.channel, side, 1 if plus else -1)
    return RigServo(None, side, 1)


def settings_of(config: str | None) -> FaceSettings | None:
    """Return the settings of a face by name or YAML path; None for None or an unreadable one."""
    if config is None:
        return None
    try:
        return load_settings(config)[0]
    except (ValueError, OSError):
        return None


def page_facts(config: str | None) -> dict[str, object]:
    """Return a face's facts for the scripts of its pages, as JSON values.

    config: the face's name or YAML path; without it, or if it cannot be read, `servos` and `rig`
    are empty.
    """
    settings = settings_of(config)
    servos = {} if settings is None else settings.servos
    return {
        "config": config,
        "rateHz": None if settings is None else settings.rate_hz,
        "servos": {name: servo_facts(servo) for name, servo in servos.items()},
        "rig": {
            name: {"channel": motion.channel, "side": motion.side, "sign": motion.sign}
            for name, motion in robot_rig(servos).items()
        },
        "phonemeGroups": {name: group_of(name) for name in PHONEMES if name != SILENCE},
        "groupColours": {name: (fill, ink) for name, (_, fill, ink, _) in GROUPS.items()},
    }


def servo_facts(servo: ServoSettings) -> dict[str, object]:
    """Return a servo's id, model, part, direction, limits (joint degrees), pulse and bounds.

    None for an id, model or pulse that the servo does not have.
    """
    return {
        "id": servo.address,
        "model": servo.make,
        "part": servo.part,
        "positive": servo.positive,
        "least_deg": servo.min_deg,
        "most_deg": servo.max_deg,
        "pulse": None if servo.pulse is None else asdict(servo.pulse),
        **servo.bounds,
    }


def group_of(phoneme: str) -> str:
    """Return the name of the group in `GROUPS` that contains a phoneme's viseme class."""
    viseme = VISEME_OF[phoneme]
    return next(
        name
        for name, (_, _, _, classes) in GROUPS.items()
        if any(VISEME_OF[first] == viseme for first in classes)
    )
