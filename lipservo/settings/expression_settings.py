"""`expression:` of a face YAML: how lively head, eyes, lids and brows are, and what moves them."""

from typing import Annotated, Literal

from lipservo.settings.setting_types import Strict, Text, within

#: A degree of freedom of an expression; `lids`: the mean of both.
ExpressionName = Literal[
    "neck_pitch_deg",
    "neck_yaw_deg",
    "neck_roll_deg",
    "eye_pitch_deg",
    "eye_yaw_deg",
    "lid_left",
    "lid_right",
    "lids",
    "brow",
    "smile",
]

#: Half as lively again as people were measured to be.
LIVELIEST = 1.5
#: A day: never, for a face that is switched off at night.
_LONGEST_REST_S = 86_400.0


class ServoExpression(Strict):
    """What part of an expression a servo shows, and how far it turns for one unit of it.

    A unit is a degree, or 1 of lids, brow and smile; a negative number turns the other way.
    """

    of: ExpressionName
    deg_per_unit: Annotated[float, within(-90.0, 90.0)]


class ExpressionSettings(Strict):
    """amount: 0 still, 1 as measured on people. seed: of the motion that nobody asked for.

    eye_contact: share of the time in which the face looks at whoever it speaks with. rest_after_s:
    after so long a silence the servos are let go until somebody speaks. model: learned from tracks
    (`lipservo learn expression`), a file from the folder of the YAML.
    """

    amount: Annotated[float, within(0.0, LIVELIEST)] = 1.0
    seed: Annotated[int, within(0, 2**31 - 1)] = 0
    eye_contact: Annotated[float, within(0.05, 0.95)] | None = None
    rest_after_s: Annotated[float, within(10.0, _LONGEST_REST_S)] = 600.0
    model: Text | None = None
