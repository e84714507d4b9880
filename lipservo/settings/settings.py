"""The face YAML: its schema, how it is read, and how an error in it is explained."""

import hashlib
import json
import math
from collections.abc import Mapping
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import (
    ValidationError,
    field_validator,
    model_validator,
)

from firmware_bridge.dynamixel.control_table import servo_models
from firmware_bridge.joints import Joint
from lipservo.settings.sections import (
    Acceleration,
    AccessSettings,
    AvatarSettings,
    BaudRate,
    CalibrationName,
    Degrees,
    ExpressionSettings,
    JointName,
    Milliamperes,
    MotionSettings,
    PreventSettings,
    RateHz,
    ServoExpression,
    ServoId,
    Sign,
    SoundSettings,
    Speed,
    StaleSettings,
    Strict,
    Text,
    TrackingSettings,
    within,
)
from lipservo.settings.strict_yaml import SettingsError, explain, read_mapping

_CALIBRATION_SUFFIX = ".calibration.yaml"


ServoModel = Literal[
    "XL330-M077",
    "XL330-M288",
    "XC330-M288",
    "XC330-T288",
    "XL430-W250",
    "XM430-W210",
    "XM430-W350",
]


class BusSettings(Strict):
    """How the servos are reached: in memory, or through a serial port."""

    kind: Literal["simulated", "dynamixel"] = "simulated"
    port: Text | None = None
    baud_rate: BaudRate = 1_000_000
    backend: Literal["own", "dynamixel-sdk"] = "own"

    @model_validator(mode="after")
    def _real_servos_have_a_port(self) -> Self:
        if self.kind == "dynamixel" and self.port is None:
            raise ValueError("needs `port:`, /dev/serial/by-id/... or /dev/ttyUSB0 for one")
        return self


class ServoSettings(Strict):
    """One servo and the joint it drives, in joint degrees: 0 = the joint's neutral.

    `positive` says in a word what a positive angle does. The servo's own angle is
    sign x (joint angle + zero_offset_deg). critical: without this servo the whole face stops.
    max_current_ma: the servo never pulls harder; only models that measure current.
    """

    id: ServoId
    model: ServoModel
    positive: Text
    min_deg: Degrees
    max_deg: Degrees
    max_speed_deg_s: Speed
    sign: Sign = 1
    zero_offset_deg: Degrees = 0.0
    max_acceleration_deg_s2: Acceleration | None = None
    max_current_ma: Milliamperes | None = None
    critical: bool = False
    #: What it moves; only the mouth is calibrated to a speaker.
    part: Literal["mouth", "neck", "eyes", "lids", "brows"] = "mouth"
    expression: ServoExpression | None = None

    @model_validator(mode="after")
    def _neutral_is_within_reach(self) -> Self:
        if not self.min_deg <= 0.0 <= self.max_deg:
            raise ValueError(
                f"needs min_deg <= 0 <= max_deg, got {self.min_deg:g} and {self.max_deg:g}"
            )
        return self

    @model_validator(mode="after")
    def _the_servo_can_do_it(self) -> Self:
        for name, angle in (("min_deg", self.min_deg), ("max_deg", self.max_deg)):
            servo_deg = self.sign * (angle + self.zero_offset_deg)
            if not -180.0 <= servo_deg < 180.0:
                raise ValueError(
                    f"{name} puts the servo at {servo_deg:g} deg; it reaches -180..180"
                )
        fastest = servo_models()[self.model].no_load_deg_s
        if self.max_speed_deg_s > fastest:
            raise ValueError(
                f"max_speed_deg_s {self.max_speed_deg_s:g} is more than an {self.model} makes "
                f"without load, {fastest:g}"
            )
        return self

    @model_validator(mode="after")
    def _a_mouth_only_smiles(self) -> Self:
        shown = None if self.expression is None else self.expression.of
        if self.part == "mouth" and shown not in (None, "smile"):
            raise ValueError(f"expression.of {shown} needs another `part:`; a mouth may smile")
        return self

    @model_validator(mode="after")
    def _the_servo_can_limit_its_current(self) -> Self:
        model = servo_models()[self.model]
        if self.max_current_ma is None:
            return self
        if model.current_unit_ma is None:
            raise ValueError(f"max_current_ma: an {self.model} does not measure current")
        most_ma = model.defaults["current_limit"] * model.current_unit_ma
        if self.max_current_ma > most_ma:
            raise ValueError(
                f"max_current_ma {self.max_current_ma:g} is more than an {self.model} takes, "
                f"{most_ma:g}"
            )
        return self


class FaceSettings(Strict):
    """A whole face. The order of `servos` is the order of positions everywhere."""

    name: Text
    rate_hz: RateHz
    servos: Mapping[JointName, ServoSettings]
    bus: BusSettings = BusSettings()
    calibration: CalibrationName | None = None
    prevent: tuple[PreventSettings, ...] = ()
    stale: StaleSettings = StaleSettings()
    tracking: TrackingSettings = TrackingSettings()
    motion: MotionSettings = MotionSettings()
    sound: SoundSettings = SoundSettings()
    expression: ExpressionSettings = ExpressionSettings()
    access: AccessSettings = AccessSettings()
    avatars: AvatarSettings = AvatarSettings()
    #: Whether a service drives the face by itself after a power cut that may have lost a stop.
    start_after_power_cut: bool = False
    #: Between the outer corners of the robot's eyes: what gives a photograph its scale.
    eye_distance_mm: Annotated[float, within(10.0, 500.0)] | None = None

    @field_validator("prevent", mode="before")
    @classmethod
    def _a_list_will_do(cls, rules: object) -> object:
        return tuple(rules) if isinstance(rules, list) else rules

    @model_validator(mode="after")
    def _rules_name_known_joints(self) -> Self:
        known = set(self.servos)
        for n, rule in enumerate(self.prevent):
            unknown = sorted(set(rule.joints) - known)
            if unknown:
                raise ValueError(
                    f"prevent.{n} names {unknown[0]!r}, which is no joint of this face"
                )
            if rule.above < 0.0:
                raise ValueError(f"prevent.{n}.above is below 0: neutral itself would be forbidden")
        return self

    @field_validator("servos")
    @classmethod
    def _every_servo_has_its_own_id(
        cls, servos: Mapping[str, ServoSettings]
    ) -> Mapping[str, ServoSettings]:
        if not servos:
            raise ValueError("needs at least one servo")
        first: dict[int, str] = {}
        errors = [
            f"{first[servo.id]} and {name} both have id {servo.id}; every servo needs its own"
            for name, servo in servos.items()
            if first.setdefault(servo.id, name) != name
        ]
        if errors:
            raise ValueError("\n".join(errors))
        return servos

    @property
    def servo_port(self) -> str | None:
        """Where the servos are; None: simulated in memory."""
        return self.bus.port if self.bus.kind == "dynamixel" else None

    @property
    def mouth_servos(self) -> Mapping[str, ServoSettings]:
        """Those that speech moves, in the order of the YAML."""
        return {name: servo for name, servo in self.servos.items() if servo.part == "mouth"}

    @property
    def checksum(self) -> str:
        """16 hex digits over all that a calibration depends on: the mouth's joints and limits.

        Speeds, ids and mounting (`sign`, `zero_offset_deg`) may change under a calibration, which
        speaks of joint angles only.
        """
        mouth = self.mouth_servos.items()
        matter = [(name, servo.min_deg, servo.max_deg) for name, servo in mouth]
        return hashlib.sha256(json.dumps(matter).encode()).hexdigest()[:16]

    def joints(self) -> tuple[Joint, ...]:
        """Return the joints in the order of the YAML."""
        return tuple(
            Joint(
                name=name,
                servo_id=servo.id,
                min_deg=servo.min_deg,
                max_deg=servo.max_deg,
                max_speed_deg_s=servo.max_speed_deg_s,
                max_acceleration_deg_s2=servo.max_acceleration_deg_s2 or math.inf,
                critical=servo.critical,
            )
            for name, servo in self.servos.items()
        )


def load_face(path: Path) -> FaceSettings:
    """Read a face YAML. Raises SettingsError with one line for each error in it."""
    return _load(path)


def load_shipped_face(name: str) -> FaceSettings:
    """Read a face that comes with lipservo, `face_sim` for one. Raises SettingsError."""
    if name not in shipped_faces():
        raise SettingsError(
            f"no face {name!r} is shipped; known here: {', '.join(shipped_faces())}"
        )
    return _load(_shipped() / f"{name}.yaml")


def shipped_faces() -> tuple[str, ...]:
    """Names of the faces that come with lipservo."""
    names = sorted(file.name for file in _shipped().iterdir() if file.name.endswith(".yaml"))
    return tuple(n.removesuffix(".yaml") for n in names if not n.endswith(_CALIBRATION_SUFFIX))


def calibration_file(face: FaceSettings, beside: Path | None = None) -> Traversable:
    """Find the calibration that `face` names: in the folder `beside`, else among the shipped.

    Raises SettingsError when the face names none, or none of that name is there.
    """
    if face.calibration is None:
        raise SettingsError(
            f"face {face.name!r} has no calibration; write `calibration: <file>` into its YAML"
        )
    folders: list[Traversable] = [_shipped()] if beside is None else [beside, _shipped()]
    for folder in folders:
        file = folder.joinpath(face.calibration)
        if file.is_file():
            return file
    looked_in = "among the shipped ones" if beside is None else f"in {beside} or among the shipped"
    raise SettingsError(f"face {face.name!r}: no calibration {face.calibration!r} {looked_in}")


def _shipped() -> Traversable:
    return files("lipservo.config")


def parse_face(text: str, file_name: str) -> FaceSettings:
    """The face that a YAML text describes; `file_name` names it in errors. Raises SettingsError."""
    try:
        return FaceSettings.model_validate(read_mapping(text, file_name))
    except ValidationError as error:
        raise SettingsError("\n".join(explain(error, FaceSettings, file_name))) from error


def _load(file: Traversable) -> FaceSettings:
    try:
        text = file.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise SettingsError(f"{file.name}: not UTF-8 text (byte {error.start})") from error
    except OSError as error:
        raise SettingsError(f"{file}: cannot be read: {error.strerror}") from error
    return parse_face(text, file.name)
