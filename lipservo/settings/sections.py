"""The sections of a face YAML, and the types of their numbers and words, with bounds.

`sound:`, `access:`, `expression:`, `prevent:`, `stale:`, `tracking:` and `motion:`; servos, bus and
the face as a whole are in `settings.py`.
"""

import re
from collections.abc import Iterable, Mapping
from typing import Annotated, Final, Literal, Self

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    StringConstraints,
    model_validator,
)

from firmware_bridge.bus_settings import Strict, Text, within
from lipservo.settings.motion_names import (
    DEFAULT_STRATEGY,
    FARTHEST_LIP_GAP_OFFSET_MM,
    LONGEST_LOOKAHEAD_MS,
    ON_STAGE,
    ONLY_UNITS,
    SMOOTHEST,
    STRONGEST,
    STYLE_NAMES,
    STYLES_OF,
    Strategy,
)
from lipsync.audio.channels import MIX, checked_channel
from lipsync.plugins import DEFAULT_SYNTHESIZER, RECOGNIZERS, SYNTHESIZERS

Seconds = Annotated[float, within(0.0, 3_600.0)]
Factor = Annotated[float, within(-1000.0, 1000.0)]
#: 30 Hz is video's pace. Twenty servos at 1 Mbaud can be written and read 187 times a second with
#: a millisecond for USB (bytes on the wire, fast sync read), ten 298 times; nothing needs more.
LOWEST_RATE_HZ, HIGHEST_RATE_HZ = 30.0, 200.0
RateHz = Annotated[float, within(LOWEST_RATE_HZ, HIGHEST_RATE_HZ)]
#: One word in every file, table and command: no spaces, dots or capitals to get wrong.
JOINT_NAME = r"^[a-z][a-z0-9_]*$"
JointName = Annotated[str, StringConstraints(pattern=JOINT_NAME)]
#: A file beside the face or among the shipped ones, never a path.
CALIBRATION_NAME = r"^[\w.-]+\.yaml$"
CalibrationName = Annotated[str, StringConstraints(pattern=CALIBRATION_NAME)]

#: Sound later than two seconds is no conversation; a device that says too much is measured as
#: early, by no more than what it says.
LEAST_OFFSET_MS, MOST_OFFSET_MS = -500.0, 2000.0
OffsetMs = Annotated[float, within(LEAST_OFFSET_MS, MOST_OFFSET_MS)]


class SoundSettings(Strict):
    """`sound:` of a face YAML: devices by name or part of it; the command line has precedence.

    output, input: None = the system's default. output_offset_ms: by device name or part of it, how
    much later than the device reports the sound is audible; `lipservo calibrate audio` measures it.
    synthesizer: speaks texts; voice: a voice's name, file beside the YAML or command, as the
    synthesizer needs it, "": its default. language: of texts that name none, "": en-us. volume: a
    factor, 0 is silent. channel: the one of `input` and of sound files that is heard.
    """

    output: Text | None = None
    input: Text | None = None
    output_offset_ms: Mapping[Text, OffsetMs] = Field(default_factory=dict)
    synthesizer: Annotated[Text, AfterValidator(SYNTHESIZERS.check)] = DEFAULT_SYNTHESIZER
    voice: Annotated[str, Field(max_length=1000)] = ""
    language: Annotated[str, Field(max_length=40)] = ""
    volume: Annotated[float, within(0.0, 1.0)] = 1.0
    channel: Annotated[str, AfterValidator(checked_channel)] = MIX


#: YAML has lists where settings are tuples.
FROM_LIST: Final = BeforeValidator(lambda given: tuple(given) if isinstance(given, list) else given)

#: As browsers send it: lower case, no path, no port where it is the scheme's own.
_ORIGIN: Final = re.compile(r"https?://([a-z0-9.-]+|\[[0-9a-f:.]+\])(:[0-9]{1,5})?")
_MOST_ORIGINS: Final = 16


def _check_origin(value: str) -> str:
    if not _ORIGIN.fullmatch(value):
        raise ValueError(
            f"{value!r} is not an origin of a browser; write it like https://kiosk.example or "
            "http://localhost:3000, in lower case and without a path"
        )
    return value


Origin = Annotated[str, AfterValidator(_check_origin)]


class AccessSettings(Strict):
    """`access:` of a face YAML: connections over TCP (docs/hardware.md).

    origins: of web pages whose scripts may use the agent server and the dashboard's API; they need
    the token as all clients do. queue: a second voice agent waits until the first has finished;
    otherwise it is refused.
    """

    origins: Annotated[tuple[Origin, ...], Field(max_length=_MOST_ORIGINS), FROM_LIST] = ()
    queue: bool = False


class AvatarSettings(Strict):
    """`avatars:` of a face YAML: HOST or HOST:PORT of screen avatars that show the face, too.

    osc: of a receiver of the VMC protocol over OSC. live_link: of Unreal Engine's Live Link Face.
    """

    osc: Text | None = None
    live_link: Text | None = None


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
    """`expression:` of a servo. of: the part of an expression that it shows.

    deg_per_unit: degrees for one degree, or for 1 of lids, brow and smile; a negative number turns
    in the opposite direction.
    """

    of: ExpressionName
    deg_per_unit: Annotated[float, within(-90.0, 90.0)]


class ExpressionSettings(Strict):
    """`expression:` of a face YAML: head, eyes, lids and brows. amount: 0 still, 1 as of people.

    seed: of the spontaneous motion. eye_contact: share of the time in which the eyes are on the
    partner while the robot talks; None: as of people. rest_after_s: after so long a silence torque
    is off until a person speaks.
    """

    amount: Annotated[float, within(0.0, LIVELIEST)] = 1.0
    seed: Annotated[int, within(0, 2**31 - 1)] = 0
    eye_contact: Annotated[float, within(0.05, 0.95)] | None = None
    rest_after_s: Annotated[float, within(10.0, _LONGEST_REST_S)] = 600.0


class PreventSettings(Strict):
    """A rule of `prevent:`: the sum of factor x angle of `joints` stays at most `above`, degrees.

    because: the reason, for people.
    """

    joints: Mapping[JointName, Factor]
    above: Factor
    because: Text

    def factors(self, names: Iterable[str]) -> tuple[float, ...]:
        """Return the factor of each named joint, 0 for a joint that is not in the rule."""
        return tuple(self.joints.get(name, 0.0) for name in names)


class StaleSettings(Strict):
    """`stale:` of a face YAML: what servos do when no new goals come, and after how many seconds.

    They hold their position, then move to neutral, then turn torque off.
    """

    hold_s: Seconds = 0.1
    neutral_s: Seconds = 1.0
    limp_s: Seconds = 5.0

    @model_validator(mode="after")
    def _check_times_rise(self) -> Self:
        if not self.hold_s < self.neutral_s <= self.limp_s:
            raise ValueError(
                f"needs hold_s < neutral_s <= limp_s, got {self.hold_s:g}, {self.neutral_s:g} "
                f"and {self.limp_s:g}"
            )
        return self


class TrackingSettings(Strict):
    """`tracking:` of a face YAML: torque off for a servo `error_deg` off its goal for `after_s`.

    error_deg: None = by each joint's range (`firmware_bridge.gate.tracking`).
    """

    error_deg: Annotated[float, within(1.0, 360.0)] | None = None
    after_s: Annotated[float, within(0.1, 60.0)] = 0.5


class MotionSettings(Strict):
    """`motion:` of a face YAML: how phonemes become motion; the command line has precedence.

    None: the default. engine: the recogniser; weights: its network: `default`, `grid`, or a file,
    from the folder of the YAML. stage: 1 opens and rounds the mouth for viewers at 3 m.
    low_latency: for puppeteers, goals within 150 ms of the sound, less precise.
    """

    strategy: Strategy | None = None
    engine: Annotated[Text, AfterValidator(RECOGNIZERS.check)] | None = None
    weights: Text | None = None
    lookahead_ms: Annotated[float, within(0.0, LONGEST_LOOKAHEAD_MS)] | None = None
    strength: Annotated[float, within(0.0, STRONGEST)] | None = None
    stage: Annotated[float, within(0.0, ON_STAGE)] | None = None
    smoothness: Annotated[float, within(0.0, SMOOTHEST)] | None = None
    unit_share: Annotated[float, within(0.0, ONLY_UNITS)] | None = None
    low_latency: bool = False
    lip_gap_offset_mm: (
        Annotated[float, within(-FARTHEST_LIP_GAP_OFFSET_MM, FARTHEST_LIP_GAP_OFFSET_MM)] | None
    ) = None

    @model_validator(mode="after")
    def _check_style_of_strategy(self) -> Self:
        strategy = self.strategy or DEFAULT_STRATEGY
        given = [name for name in STYLE_NAMES if getattr(self, name) is not None]
        ignored = [name for name in given if name not in STYLES_OF[strategy]]
        if ignored:
            raise ValueError(f"strategy {strategy} has no {', '.join(ignored)}; remove this key")
        return self
