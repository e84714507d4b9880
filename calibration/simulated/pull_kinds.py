"""Where the joints of an elastic robot pull, and which of these a face's own joints are.

A face's YAML says what its joints are called and what a positive angle does: enough to make a
robot that is built so. What it leaves open is shared out among the places that are left.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from calibration.joint_motion import CLOSE, DOWN, UP, Channel, JointMotion, joint_motion, words


@dataclass(frozen=True, slots=True)
class PullKind:
    """A joint: its word, where it pulls (landmarks), which way, whose lip, how far it may turn."""

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

#: What says the opposite of a kind's word.
OPPOSITES: Mapping[str, str] = {
    "opens": "closes",
    "raises": "lowers",
    "lowers": "raises",
    "widens": "narrows",
    "protrudes": "retracts",
}
#: By side: left, right, middle, both.
_OF_CHANNEL: Mapping[Channel, tuple[str, str, str, str]] = {
    "jaw": ("jaw", "jaw", "jaw", "jaw"),
    "upper_lip": ("upper_l", "upper_r", "upper_m", "upper"),
    "lower_lip": ("lower_l", "lower_r", "lower_m", "lower"),
    "corner_out": ("out_l", "out_r", "corners", "corners"),
    "corner_up": ("up_l", "up_r", "smile", "smile"),
    "protrusion": ("pucker", "pucker", "pucker", "pucker"),
}
_SIDES = ("left", "right", "middle", "both")
#: Several of one channel whose names tell no side share these out.
_SHARED: Mapping[Channel, tuple[str, ...]] = {
    "upper_lip": ("upper_l", "upper_r", "up_l", "up_r", "upper_m"),
    "lower_lip": ("lower_l", "lower_r", "lower_m"),
    "corner_out": ("out_l", "out_r"),
    "corner_up": ("up_l", "up_r"),
}
#: For joints of which nothing is known.
_ANY = ("upper", "lower", "corners", "pucker", "smile")


@dataclass(frozen=True, slots=True)
class Pull:
    """What one joint of a face does. sign: -1 where a positive angle does the kind's opposite.

    is_guess: whether name and word leave open what it moves.
    """

    kind: str
    sign: int
    is_guess: bool = False


def pulls_of(names: Sequence[str], positive: Sequence[str]) -> tuple[Pull, ...]:
    """One for each joint of a mouth, of any names and words. positive: one word a joint, or none.

    The first joint that opens is the jaw. Two joints may pull at one place.
    """
    said = positive or [""] * len(names)
    known = [joint_motion(name, word) for name, word in zip(names, said, strict=True)]
    read = [motion or _by_word(word) for motion, word in zip(known, said, strict=True)]
    taken: list[str] = []
    pulls = []
    for motion, was_known in zip(read, known, strict=True):
        kind = _kind_of(motion, read, taken)
        taken.append(kind)
        sign = 1 if motion is None else motion.sign
        pulls.append(Pull(kind, sign, was_known is None))
    return tuple(pulls)


def _by_word(word: str) -> JointMotion | None:
    """What goes up is the upper lip, what goes down the lower one."""
    told = words(word)
    if bool(told & UP) == bool(told & (DOWN | CLOSE)):
        return None
    return JointMotion("upper_lip" if told & UP else "lower_lip", "both", 1)


def _kind_of(
    motion: JointMotion | None, all_read: Sequence[JointMotion | None], taken: list[str]
) -> str:
    if motion is None:
        free = [kind for kind in _ANY if kind not in taken]
        return free[0] if free else _ANY[len(taken) % len(_ANY)]
    if motion.channel == "jaw" and "jaw" in taken:
        return "lower"
    if motion.side == "both" and motion.channel in _SHARED:
        alike = [each for each in all_read if each and each.channel == motion.channel]
        free = [kind for kind in _SHARED[motion.channel] if kind not in taken]
        if len(alike) > 1 and free:
            return free[0]
    return _OF_CHANNEL[motion.channel][_SIDES.index(motion.side)]
