"""The motion of a mouth joint, derived from its name and the word for its positive angle."""

import re
from dataclasses import dataclass
from typing import Final, Literal

#: What a joint can move. Its forward direction, which `JointMotion.sign` refers to: jaw opens;
#: upper_lip raises; lower_lip lowers; corner_out widens; corner_up raises; protrusion protrudes.
Channel = Literal["jaw", "upper_lip", "lower_lip", "corner_out", "corner_up", "protrusion"]
Side = Literal["left", "right", "middle", "both"]

UP: Final = frozenset({"raises", "raise", "lifts", "up", "upwards"})
DOWN: Final = frozenset({"lowers", "lower", "drops", "down", "downwards"})
OPEN: Final = frozenset({"opens", "open", "wider"})
CLOSE: Final = frozenset({"closes", "close", "closed", "shuts", "shut"})
_OUT: Final = frozenset({"widens", "spreads", "stretches", "out"})
_IN: Final = frozenset({"narrows", "purses", "in"})
_FORWARD: Final = frozenset({"protrudes", "pouts", "forward"})
_BACK: Final = frozenset({"retracts", "back"})

_LIP: Final = frozenset({"lip", "lips"})
_CORNER: Final = frozenset({"corner", "corners", "cheek", "cheeks", "smile"})
_LEFT: Final = frozenset({"left", "l"})
_RIGHT: Final = frozenset({"right", "r"})
_MIDDLE: Final = frozenset({"middle", "mid"})


@dataclass(frozen=True, slots=True)
class JointMotion:
    """The motion of a joint. channel: the part and direction that it moves, such as `corner_out`.

    sign: -1 where a positive angle moves the part in the opposite direction.
    """

    channel: Channel
    side: Side
    sign: Literal[1, -1]


@dataclass(frozen=True, slots=True)
class _Rule:
    """A rule that assigns a channel to a joint, by words in its name and of its direction.

    The name needs a word of each of `named`; the word for a positive angle must be one of
    `forward`, the channel's direction, or of `backward`, the opposite.
    """

    channel: Channel
    named: tuple[frozenset[str], ...]
    forward: frozenset[str]
    backward: frozenset[str]


#: The first that fits. What only one part of a mouth does needs no name: a jaw opens and corners
#: widen whatever they are called.
_RULES: Final = (
    _Rule("jaw", (frozenset({"jaw", "chin", "mandible"}),), OPEN | DOWN, CLOSE | UP),
    _Rule("upper_lip", (_LIP, frozenset({"upper", "top"})), UP | OPEN, DOWN | CLOSE),
    _Rule("lower_lip", (_LIP, frozenset({"lower", "bottom"})), DOWN | OPEN, UP | CLOSE),
    _Rule("corner_out", (_CORNER,), _OUT, _IN),
    _Rule("corner_up", (_CORNER,), UP | frozenset({"smiles"}), DOWN),
    _Rule(
        "protrusion",
        (_LIP | frozenset({"protrusion", "pout", "pucker", "kiss"}),),
        _FORWARD,
        _BACK,
    ),
    _Rule("jaw", (), frozenset({"opens"}), frozenset({"closes"})),
    _Rule("corner_out", (), frozenset({"widens"}), frozenset({"narrows"})),
)


def joint_motion(name: str, positive: str) -> JointMotion | None:
    """Return a joint's motion by its name and the word for its positive angle, such as `opens`.

    None if these do not define a motion.
    """
    named, positive_words = words(name), words(positive)
    for rule in _RULES:
        if not all(named & each for each in rule.named):
            continue
        forward, backward = (
            bool(positive_words & rule.forward),
            bool(positive_words & rule.backward),
        )
        if forward != backward:
            return JointMotion(rule.channel, side_of(name), 1 if forward else -1)
    return None


def side_of(name: str) -> Side:
    """Return the side, the robot's own, that a joint's name contains; `both` without one."""
    named = words(name)
    left, right = bool(named & _LEFT), bool(named & _RIGHT)
    if left != right:
        return "left" if left else "right"
    return "middle" if named & _MIDDLE and not left else "both"


def words(text: str) -> frozenset[str]:
    """Return the lower-case words in a text, letters only: of `m2_upper_lip`, m, upper and lip."""
    return frozenset(re.findall(r"[a-z]+", text.lower()))
