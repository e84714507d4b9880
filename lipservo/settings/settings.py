"""The face YAML: its schema, how it is read, and how its errors are explained."""

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from functools import cache, lru_cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ModelWrapValidatorHandler,
    PlainValidator,
    StringConstraints,
    ValidationError,
    create_model,
    field_validator,
    model_validator,
)
from pydantic_core import InitErrorDetails

from firmware_bridge.bus_kinds import BusKind, UnknownBusError, Wiring, bus_kind
from firmware_bridge.bus_settings import BusServo, BusSettings, Strict, Text, within
from firmware_bridge.capabilities import BusCapabilities, mixed_capabilities
from firmware_bridge.joints import Joint
from firmware_bridge.port_names import BUS_NAME, named_ports, ports_text
from lipservo.settings.sections import (
    FROM_LIST,
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
BusName = Annotated[str, StringConstraints(pattern=BUS_NAME)]


class ServoSettings(BusServo):
    """A servo of a face YAML and the joint it drives; its bus's kind adds keys (`face_schema`).

    critical: if this servo fails, the whole face stops.
    """

    critical: bool = False
    #: What it moves; only the mouth is calibrated to a speaker. A tongue, and what else no marker
    #: shows, moves by its own `expression:` or not at all.
    part: Literal["mouth", "neck", "eyes", "lids", "brows", "tongue", "other"] = "mouth"
    expression: ServoExpression | None = None

    @model_validator(mode="after")
    def _check_mouth_expression(self) -> Self:
        shown = None if self.expression is None else self.expression.of
        if self.part == "mouth" and shown not in (None, "smile"):
            raise ValueError(f"with `part: mouth` only `of: smile` works, not {shown}; remove it")
        return self


class _UnknownBus(BusSettings):
    """A `bus:` of a kind that is not installed, whose other keys cannot be checked."""

    model_config = ConfigDict(extra="ignore")

    @field_validator("kind", mode="before")
    @classmethod
    def _check_kind_text(cls, kind: object) -> object:
        if not isinstance(kind, str):
            raise ValueError(f"{shown(kind)} is not text")
        try:
            return bus_kind(kind).name
        except UnknownBusError as error:
            raise ValueError(str(error)) from error


class FaceSettings(Strict):
    """The settings of a face: a whole face YAML. All arrays of servos are in the order of `servos`.

    The keys of `bus` and its servos depend on the kind of the bus: `model_validate` uses the schema
    from `face_schema`.
    """

    #: What stands under a key whose values differ by their names, for who explains errors.
    by_name: ClassVar[Mapping[str, Mapping[str, type[BaseModel]]]] = {}

    name: Text
    rate_hz: RateHz
    servos: Mapping[JointName, ServoSettings]
    bus: BusSettings = BusSettings()
    #: Several of them, in place of `bus`; each servo then says its own.
    buses: Mapping[BusName, BusSettings] = {}
    calibration: CalibrationName | None = None
    prevent: Annotated[tuple[PreventSettings, ...], FROM_LIST] = ()
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
    def _validate_by_bus(
        cls, content: object, validate: ModelWrapValidatorHandler[Self]
    ) -> "FaceSettings":
        """Validate a face YAML's content by the schema with the keys of its kinds of bus.

        validate: pydantic's own validation by this class.
        """
        if cls is FaceSettings and isinstance(content, Mapping):
            return face_schema(content).model_validate(content)
        return validate(content)

    def __reduce__(self) -> tuple[Any, ...]:
        # Its class is made anew in every process.
        return FaceSettings.model_validate, (self.model_dump(),)

    @model_validator(mode="after")
    def _check_rules(self) -> Self:
        """Raise ValueError if a rule of `prevent` names an unknown joint or forbids neutral."""
        for n, rule in enumerate(self.prevent):
            unknown = sorted(set(rule.joints) - set(self.servos))
            if unknown:
                raise ValueError(f"prevent.{n} names {unknown[0]!r}, but no joint has this name")
            if rule.above < 0.0:
                raise ValueError(f"prevent.{n}.above is below 0, which would forbid neutral")
        return self

    @field_validator("servos")
    @classmethod
    def _check_addresses(cls, servos: Mapping[str, ServoSettings]) -> Mapping[str, ServoSettings]:
        """Raise ValueError if there is no servo, or two on one bus have the same address."""
        if not servos:
            raise ValueError("at least one servo is needed")
        first_name: dict[tuple[str, int], str] = {}
        errors = []
        for name, servo in servos.items():
            bus = bus_of(servo)
            other = first_name.setdefault((bus, servo.address), name)
            if other != name:
                errors.append(
                    f"{other} and {name} both have {servo.address_key} {servo.address}"
                    f"{bus and f' on bus {bus}'}; every servo needs its own"
                )
        if errors:
            raise ValueError("\n".join(errors))
        return servos

    @model_validator(mode="after")
    def _check_buses(self) -> Self:
        """Raise ValueError for a bus without a servo, and for two with one board or one OE pin."""
        first_name: dict[str, str] = {}
        for name, bus in self.buses.items():
            if name not in self.bus_of:
                raise ValueError(f"buses.{name} has no servo (`bus: {name}`); remove it")
            own = [] if bus.port is None else [f"port {bus.port} {bus.board}".rstrip()]
            if (pin := getattr(bus, "oe_gpio", None)) is not None:
                own.append(f"oe_gpio {pin} of {getattr(bus, 'gpio_chip', '')}")
            for what in own:
                if (one := first_name.setdefault(what, name)) != name:
                    raise ValueError(f"buses {one} and {name} both have {what}; give each its own")
        return self

    @property
    def bus_of(self) -> tuple[str, ...]:
        """The bus name of each servo, in order; empty strings if the face has one bus."""
        return tuple(map(bus_of, self.servos.values()))

    @property
    def servo_port(self) -> str | None:
        """The port of the servos, or `bus=port,...` for several; None: in memory, or not given."""
        if self.buses:
            ports = {name: face.servo_port for name, face in self.alone.items()}
            return ports_text({name: port for name, port in ports.items() if port is not None})
        return None if self.capabilities.in_memory else self.bus.port

    @property
    def alone(self) -> Mapping[str, Self]:
        """The servos of each bus as a separate face, by the bus's name; for one bus, {"": self}."""
        return {name: self.of_bus(name) for name in self.buses} or {"": self}

    def of_bus(self, name: str) -> Self:
        """Return a face with the servos of one bus only, named after both face and bus.

        Raises SettingsError if there is no such bus.
        """
        if name not in self.buses:
            known = ", ".join(self.buses) or "one, without a name"
            raise SettingsError(f"{self.name} has no bus {name:.60}; its buses: {known}")
        servos = {key: servo for key, servo in self.servos.items() if bus_of(servo) == name}
        face_name, bus = f"{self.name} {name}", self.buses[name]
        changes = {"name": face_name, "bus": bus, "buses": {}, "servos": servos, "prevent": ()}
        return self.model_copy(update=changes)

    @property
    def bus_kind(self) -> BusKind:
        """The kind of the face's bus. Raises SettingsError if the face has several buses."""
        if self.buses:
            names = ", ".join(self.buses)
            raise SettingsError(f"{self.name} has several buses: {names}; choose with --bus NAME")
        return bus_kind(self.bus.kind)

    @property
    def capabilities(self) -> BusCapabilities:
        """The abilities of the face's servos, such as reporting positions, by their buses."""
        if self.buses:
            can = {name: face.capabilities for name, face in self.alone.items()}
            return mixed_capabilities(can, self.bus_of)
        return self.bus_kind.capabilities(self.bus)

    @property
    def wiring(self) -> Wiring:
        """The bus, joints, servos and rate, from which the face's one bus is opened."""
        return Wiring(self.bus, self.joints(), tuple(self.servos.values()), self.rate_hz)

    def at_port(self, port: str) -> Self:
        """Return the face with its servos at `port`; for several buses `bus=port,...`.

        Raises SettingsError if `port` does not name them so, or names an unknown bus.
        """
        if self.buses:
            return self._at_named_ports(port)
        kind = self.bus_kind.at_port or self.bus.kind
        bus = self.bus.model_copy(update={"kind": kind, "port": port})
        return self.model_copy(update={"bus": bus})

    def _at_named_ports(self, text: str) -> Self:
        """Return the face with its buses at the ports in `text`, as `lips=PORT,neck=PORT`.

        Raises SettingsError if `text` names no buses, or an unknown one.
        """
        ports = named_ports(text)
        if ports is None:
            options = " ".join(f"--port {name}=PORT" for name in self.buses)
            raise SettingsError(
                f"--port {text}: {self.name} has several buses; write each as {options}"
            )
        moved = {name: self.of_bus(name).at_port(port).bus for name, port in ports.items()}
        return self.model_copy(update={"buses": {**self.buses, **moved}})

    @property
    def mouth_servos(self) -> Mapping[str, ServoSettings]:
        """The servos that speech moves, by name, in the order of the YAML."""
        return {name: servo for name, servo in self.servos.items() if servo.part == "mouth"}

    @property
    def checksum(self) -> str:
        """A hash, 16 hex digits, of what a calibration depends on: the mouth's joints and limits.

        Speeds, ids and mounting (`sign`, `zero_offset_deg`) may change under a calibration, which
        contains joint angles only.
        """
        mouth = self.mouth_servos.items()
        relevant = [(name, servo.min_deg, servo.max_deg) for name, servo in mouth]
        return hashlib.sha256(json.dumps(relevant).encode()).hexdigest()[:16]

    def joints(self) -> tuple[Joint, ...]:
        """Return a `Joint` for each servo, in the order of the YAML."""
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
    """Return the schema for the content of a face YAML, with the keys of its kinds of bus.

    For an unknown kind, servos are checked as those of the default kind; for one of several buses,
    their other keys are not checked.
    """
    buses = content.get("buses")
    if isinstance(buses, Mapping) and buses:
        return _schema_of_buses(_kinds_of(buses))
    bus = content.get("bus", BusSettings())
    kind = bus.get("kind", BusSettings().kind) if isinstance(bus, Mapping) else bus
    return _schema_of_kind_name(kind.kind if isinstance(kind, BusSettings) else kind)


def _schema_of_kind_name(kind: object) -> type[FaceSettings]:
    """Return the schema of a face with one bus, by the name of its kind.

    For an unknown kind its other keys are not checked, and servos are as on the default kind.
    """
    try:
        return _schema_of_kind(bus_kind(kind if isinstance(kind, str) else ""))
    except UnknownBusError:
        default_schema = _schema_of_kind(bus_kind(BusSettings().kind))
        return create_model("FaceSettings", __base__=default_schema, bus=(_UnknownBus, ...))


@cache
def _schema_of_kind(kind: BusKind) -> type[FaceSettings]:
    """Return the schema of a face with one bus of `kind`: that kind's keys of bus and servos."""
    bus = kind.settings
    servo = _servo_schema(kind)
    has_required = any(field.is_required() for field in bus.model_fields.values())
    return create_model(
        "FaceSettings",
        __base__=FaceSettings,
        servos=(Mapping[JointName, servo], ...),  # type: ignore[valid-type]
        bus=(bus, ... if has_required else bus()),
    )


@cache
def _servo_schema(kind: BusKind) -> Any:
    return create_model("ServoSettings", __base__=(ServoSettings, kind.servo))


class _ServoOfUnknownBus(ServoSettings):
    """A servo on an unknown kind of bus, whose other keys cannot be checked."""

    model_config = ConfigDict(extra="ignore")

    @property
    def address(self) -> int:
        """A number that differs for each servo, in place of the unknown address."""
        return id(self)


_Kinds = tuple[tuple[Any, BusKind | None], ...]


def _kinds_of(buses: Mapping[Any, Any]) -> _Kinds:
    return tuple((name, _kind_of(bus)) for name, bus in buses.items())


@cache
def _servo_schemas(kinds: _Kinds) -> Mapping[Any, type[BaseModel]]:
    """Return the schema of a servo for each bus, by the bus's name."""
    return {
        name: _ServoOfUnknownBus
        if kind is None
        else create_model("ServoSettings", __base__=_servo_schema(kind), bus=(str, ...))
        for name, kind in kinds
    }


@cache
def _schema_of_buses(kinds: _Kinds) -> type[FaceSettings]:
    """Return the schema of a face with several buses, each checked by its kind."""
    servo_schemas = _servo_schemas(kinds)

    def servo_of(value: object) -> BaseModel:
        name = bus_of(value)
        if isinstance(value, Mapping) and name not in servo_schemas:
            raise _no_bus_error(value, name, list(map(str, servo_schemas)))
        return servo_schemas.get(name, ServoSettings).model_validate(value)

    def bus_by_kind(value: object) -> BaseModel:
        return _settings_of(_kind_of(value)).model_validate(value)

    def refuse_bus(_value: object) -> object:
        raise ValueError("this face has `bus` and `buses`; remove one of them")

    return create_model(
        "FaceSettings",
        __base__=FaceSettings,
        servos=(Mapping[JointName, Annotated[Any, PlainValidator(servo_of)]], ...),
        buses=(Mapping[BusName, Annotated[Any, PlainValidator(bus_by_kind)]], ...),
        bus=(
            Annotated[BusSettings, BeforeValidator(refuse_bus)],
            Field(default=BusSettings(), exclude=True),
        ),
    )


def _schema_with_keys(schema: type[FaceSettings], content: Mapping[Any, Any]) -> type[FaceSettings]:
    """Return `schema` with the keys of each servo and bus in `content`, for error messages.

    With one bus, or content of another form, it is returned unchanged.
    """
    buses, servos = content.get("buses"), content.get("servos")
    if not isinstance(buses, Mapping) or not isinstance(servos, Mapping):
        return schema
    kinds = _kinds_of(buses)
    known = _servo_schemas(kinds)
    with_names = create_model("FaceSettings", __base__=schema)
    with_names.by_name = {
        "servos": {name: known.get(bus_of(servo), ServoSettings) for name, servo in servos.items()},
        "buses": {name: _settings_of(kind) for name, kind in kinds},
    }
    return with_names


def _settings_of(kind: BusKind | None) -> type[BusSettings]:
    return _UnknownBus if kind is None else kind.settings


def bus_of(servo: object) -> str:
    """Return the bus name in a servo's settings or its unchecked YAML value; empty if none."""
    bus_name = servo.get("bus") if isinstance(servo, Mapping) else getattr(servo, "bus", None)
    return bus_name if isinstance(bus_name, str) else ""


def _kind_of(bus: object) -> BusKind | None:
    """Return the kind of a bus, from settings or its unchecked YAML value; None if unknown."""
    default = BusSettings().kind
    kind = bus.get("kind", default) if isinstance(bus, Mapping) else getattr(bus, "kind", default)
    try:
        return bus_kind(kind) if isinstance(kind, str) else None
    except UnknownBusError:
        return None


def _no_bus_error(servo: Mapping[Any, Any], name: str, known: Sequence[str]) -> ValidationError:
    """Return the error for a servo whose `bus`, `name`, is missing or is not one of `known`."""
    buses = f"the buses of this face: {', '.join(known)}"
    bus_name = servo.get("bus")
    why = f"is missing; {buses}" if bus_name is None else f"{shown(bus_name)} is not one of {buses}"
    details = InitErrorDetails(
        type="value_error", loc=("bus",), input=name, ctx={"error": ValueError(why)}
    )
    return ValidationError.from_exception_data("ServoSettings", [details])


def load_face(file: Path | Traversable) -> FaceSettings:
    """Read a face YAML. Raises SettingsError with one line for each error in it.

    Also for a file that cannot be read.
    """
    try:
        text = file.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise SettingsError(f"{file.name}: not UTF-8 text (byte {error.start})") from error
    except OSError as error:
        raise SettingsError(f"{file}: cannot be read: {error.strerror}") from error
    return parse_face(text, file.name)


def load_shipped_face(name: str) -> FaceSettings:
    """Read a face that comes with lipservo, such as `face_sim`. Raises SettingsError."""
    if name not in shipped_faces():
        raise SettingsError(
            f"no shipped face is called {name!r}; use one of {', '.join(shipped_faces())}"
        )
    return load_face(_shipped() / f"{name}.yaml")


def shipped_faces() -> tuple[str, ...]:
    """Return the sorted names of the faces that are shipped with lipservo."""
    names = sorted(file.name for file in _shipped().iterdir() if file.name.endswith(".yaml"))
    return tuple(n.removesuffix(".yaml") for n in names if not n.endswith(_CALIBRATION_SUFFIX))


def calibration_file(face: FaceSettings, beside: Path | None = None) -> Traversable:
    """Return the calibration file that `face` names: in the folder `beside`, else a shipped one.

    Raises SettingsError if the face names none, or none of that name exists.
    """
    if face.calibration is None:
        raise SettingsError(
            f"face {face.name!r} has no calibration; write `calibration: FILE` in its YAML"
        )
    folders: list[Traversable] = [_shipped()] if beside is None else [beside, _shipped()]
    for folder in folders:
        file = folder.joinpath(face.calibration)
        if file.is_file():
            return file
    looked_in = "among the shipped ones" if beside is None else f"in {beside} or among the shipped"
    raise SettingsError(f"face {face.name!r}: calibration {face.calibration!r} is not {looked_in}")


def _shipped() -> Traversable:
    return files("lipservo.config")


@lru_cache(maxsize=8)  # a run reads the same file for sound, face and servos
def parse_face(text: str, file_name: str) -> FaceSettings:
    """Parse a YAML text as a face; `file_name` names it in errors. Raises SettingsError."""
    content = read_mapping(text, file_name)
    schema = face_schema(content)
    try:
        return schema.model_validate(content)
    except ValidationError as error:
        lines = explain(error, _schema_with_keys(schema, content), file_name)
        raise SettingsError("\n".join(lines)) from error
