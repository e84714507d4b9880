"""The face YAML: its schema, how it is read, and how an error in it is explained."""

import hashlib
import json
import math
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import (
    ConfigDict,
    ModelWrapValidatorHandler,
    ValidationError,
    create_model,
    field_validator,
    model_validator,
)

from firmware_bridge.bus_kinds import BusKind, UnknownBusError, Wiring, bus_kind
from firmware_bridge.bus_settings import BusServo, BusSettings, Strict, Text, within
from firmware_bridge.capabilities import BusCapabilities
from firmware_bridge.joints import Joint
from lipservo.settings.sections import (
    AccessSettings,
    AvatarSettings,
    CalibrationName,
    ExpressionSettings,
    JointName,
    MotionSettings,
    PreventSettings,
    RateHz,
    ServoExpression,
    SoundSettings,
    StaleSettings,
    TrackingSettings,
)
from lipservo.settings.strict_yaml import SettingsError, explain, read_mapping
from lipsync.errors import shown

_CALIBRATION_SUFFIX = ".calibration.yaml"


class ServoSettings(BusServo):
    """One servo and the joint it drives, with the keys of its kind of bus (`face_schema`).

    critical: without this servo the whole face stops.
    """

    critical: bool = False
    #: What it moves; only the mouth is calibrated to a speaker.
    part: Literal["mouth", "neck", "eyes", "lids", "brows"] = "mouth"
    expression: ServoExpression | None = None

    @model_validator(mode="after")
    def _a_mouth_only_smiles(self) -> Self:
        shown = None if self.expression is None else self.expression.of
        if self.part == "mouth" and shown not in (None, "smile"):
            raise ValueError(f"expression.of {shown} needs another `part:`; a mouth may smile")
        return self


class _UnknownBus(BusSettings):
    """`bus:` of a kind that is not installed: its other keys cannot be judged."""

    model_config = ConfigDict(extra="ignore")

    @field_validator("kind", mode="before")
    @classmethod
    def _is_not_known(cls, kind: object) -> object:
        if not isinstance(kind, str):
            raise ValueError(f"{shown(kind)} is not text")
        try:
            return bus_kind(kind).name
        except UnknownBusError as error:
            raise ValueError(str(error)) from error


class FaceSettings(Strict):
    """A whole face. The order of `servos` is the order of positions everywhere.

    Which keys `bus` and its servos have is said by the kind of the bus: `face_schema`, which
    `model_validate` goes by.
    """

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

    @model_validator(mode="wrap")
    @classmethod
    def _as_its_bus_has_it(
        cls, content: object, as_it_is: ModelWrapValidatorHandler[Self]
    ) -> "FaceSettings":
        if cls is FaceSettings and isinstance(content, Mapping):
            return face_schema(content).model_validate(content)
        return as_it_is(content)

    def __reduce__(self) -> tuple[Any, ...]:
        # Its class is made anew in every process.
        return FaceSettings.model_validate, (self.model_dump(),)

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
    def _every_servo_has_its_own_address(
        cls, servos: Mapping[str, ServoSettings]
    ) -> Mapping[str, ServoSettings]:
        if not servos:
            raise ValueError("needs at least one servo")
        first: dict[int, str] = {}
        errors = [
            f"{first[servo.address]} and {name} both have {servo.address_key} {servo.address}; "
            "every servo needs its own"
            for name, servo in servos.items()
            if first.setdefault(servo.address, name) != name
        ]
        if errors:
            raise ValueError("\n".join(errors))
        return servos

    @property
    def servo_port(self) -> str | None:
        """Where the servos are; None: simulated in memory."""
        return None if self.capabilities.in_memory else self.bus.port

    @property
    def bus_kind(self) -> BusKind:
        """What opens, simulates and examines its bus."""
        return bus_kind(self.bus.kind)

    @property
    def capabilities(self) -> BusCapabilities:
        """What its servos can do."""
        return self.bus_kind.capabilities(self.bus)

    @property
    def wiring(self) -> Wiring:
        """Its servos as the bus knows them."""
        return Wiring(self.bus, self.joints(), tuple(self.servos.values()), self.rate_hz)

    def at_port(self, port: str) -> Self:
        """The same face with its servos at a port."""
        kind = self.bus_kind.at_port or self.bus.kind
        bus = self.bus.model_copy(update={"kind": kind, "port": port})
        return self.model_copy(update={"bus": bus})

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
                servo_id=servo.address,
                min_deg=servo.min_deg,
                max_deg=servo.max_deg,
                max_speed_deg_s=servo.max_speed_deg_s,
                max_acceleration_deg_s2=servo.max_acceleration_deg_s2 or math.inf,
                critical=servo.critical,
                address_key=servo.address_key,
                pulse=servo.pulse,
            )
            for name, servo in self.servos.items()
        )


def face_schema(content: Mapping[Any, Any]) -> type[FaceSettings]:
    """What a face may hold whose YAML has this content: bus and servos as its kind of bus has them.

    For a kind that nobody knows, the servos are those of the default kind.
    """
    bus = content.get("bus", BusSettings())
    kind = bus.get("kind", BusSettings().kind) if isinstance(bus, Mapping) else bus
    return _schema(kind.kind if isinstance(kind, BusSettings) else kind)


def _schema(kind: object) -> type[FaceSettings]:
    try:
        return _schema_of(bus_kind(kind if isinstance(kind, str) else ""))
    except UnknownBusError:
        known = _schema_of(bus_kind(BusSettings().kind))
        return create_model("FaceSettings", __base__=known, bus=(_UnknownBus, ...))


@cache
def _schema_of(kind: BusKind) -> type[FaceSettings]:
    bus = kind.settings
    servo = create_model("ServoSettings", __base__=(ServoSettings, kind.servo))
    needs_keys = any(field.is_required() for field in bus.model_fields.values())
    return create_model(
        "FaceSettings",
        __base__=FaceSettings,
        servos=(Mapping[JointName, servo], ...),  # type: ignore[valid-type]
        bus=(bus, ... if needs_keys else bus()),
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
    content = read_mapping(text, file_name)
    schema = face_schema(content)
    try:
        return schema.model_validate(content)
    except ValidationError as error:
        raise SettingsError("\n".join(explain(error, schema, file_name))) from error


def _load(file: Traversable) -> FaceSettings:
    try:
        text = file.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise SettingsError(f"{file.name}: not UTF-8 text (byte {error.start})") from error
    except OSError as error:
        raise SettingsError(f"{file}: cannot be read: {error.strerror}") from error
    return parse_face(text, file.name)
