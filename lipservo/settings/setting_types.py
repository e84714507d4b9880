"""Numbers and words as they may stand in a face YAML, each with its bounds."""

from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, StringConstraints

from firmware_bridge.dynamixel.control_table import baud_rates


def within(low: float, high: float) -> AfterValidator:
    """Accept numbers from `low` to `high`; one check, so that the message can name both ends."""

    def check(value: float) -> float:
        if not low <= value <= high:
            raise ValueError(f"{value:g} is outside {low:g}..{high:g}")
        return value

    return AfterValidator(check)


def _check_sign(value: int) -> int:
    if value not in (1, -1):
        raise ValueError(f"{value} is neither 1 nor -1")
    return value


def _check_baud_rate(value: int) -> int:
    known = sorted(baud_rates().values())
    if value not in known:
        raise ValueError(f"{value} is no rate of these servos; use one of {known}")
    return value


#: Ids a Dynamixel may have: https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/#id
ServoId = Annotated[int, within(0, 252)]
#: Half a turn to each side is all that position control reaches (control mode 3, one turn).
Degrees = Annotated[float, within(-180.0, 180.0)]
#: The fastest servo below, XL330-M077-T, makes 383 rev/min without load at 5 V (its e-manual page).
#: Slower than 1 deg/s no mouth speaks, and Ctrl-C would not bring it home.
Speed = Annotated[float, within(1.0, 2298.0)]
#: Top speed within 50 ms at least, or speech is lost; within a millisecond is no limit any more.
Acceleration = Annotated[float, within(100.0, 2_000_000.0)]
#: No servo moves even itself with less; no X servo takes more.
Milliamperes = Annotated[float, within(10.0, 5_000.0)]
Seconds = Annotated[float, within(0.0, 3_600.0)]
Factor = Annotated[float, within(-1000.0, 1000.0)]
#: Not a Literal: that would take `true` for 1.
Sign = Annotated[int, AfterValidator(_check_sign)]
BaudRate = Annotated[int, AfterValidator(_check_baud_rate)]
#: 30 Hz is video's pace. Twenty servos at 1 Mbaud can be written and read 187 times a second with
#: a millisecond for USB (bytes on the wire, fast sync read), ten 298 times; nothing needs more.
RateHz = Annotated[float, within(30.0, 200.0)]
#: One word in every file, table and command: no spaces, dots or capitals to get wrong.
JOINT_NAME = r"^[a-z][a-z0-9_]*$"
JointName = Annotated[str, StringConstraints(pattern=JOINT_NAME)]
#: A file beside the face or among the shipped ones, never a path.
CALIBRATION_NAME = r"^[\w.-]+\.yaml$"
CalibrationName = Annotated[str, StringConstraints(pattern=CALIBRATION_NAME)]
Text = Annotated[str, StringConstraints(min_length=1)]


class Strict(BaseModel):
    """No unknown key, no conversion between types, no change after reading."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)
