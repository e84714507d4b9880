"""A face from its files (settings, model, calibration), with its servos, bus and bridge."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from calibration.calibration import (
    Calibration,
    CouplingRule,
    ServoMemory,
    check_calibration,
    check_servo_memories,
    check_servo_models,
)
from calibration.files.calibration_file import parse_calibration
from firmware_bridge.bus import ServoBus
from firmware_bridge.clock import Clock, ManualClock
from firmware_bridge.dynamixel.bus import slow_adapter
from firmware_bridge.dynamixel.control_table import servo_models
from firmware_bridge.dynamixel.mounting import MountedServo
from firmware_bridge.dynamixel.wire.line import Transport
from firmware_bridge.dynamixel.wire.serial_transport import SameAdapter, latency_timer_ms
from firmware_bridge.gate.limits import PreventRule
from firmware_bridge.gate.ramp import StaleRule
from firmware_bridge.gate.tracking import TrackingRule
from firmware_bridge.joints import Joint
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.report import BridgeSettings
from firmware_bridge.loop.targets import TargetChannel
from firmware_bridge.simulator.bus import SimulatedBus
from lipservo.settings.settings import FaceSettings, calibration_file, load_face, load_shipped_face
from lipsync.face.model import FaceModel
from lipsync.face.model import load_face as load_face_model

if TYPE_CHECKING:
    from firmware_bridge.dynamixel.bus import DynamixelBus


def mounted_servos(face: FaceSettings) -> list[MountedServo]:
    """Every servo in its place, in the order of the YAML."""
    return [
        MountedServo(
            joint,
            servo_models()[servo.model],
            servo.sign,
            servo.zero_offset_deg,
            servo.max_current_ma,
        )
        for joint, servo in zip(face.joints(), face.servos.values(), strict=True)
    ]


def prevent_rules(face: FaceSettings) -> list[PreventRule]:
    """What the face's joints must not do together."""
    return [
        PreventRule(rule.factors(face.servos), rule.above, rule.because) for rule in face.prevent
    ]


def bridge_for(
    face: FaceSettings,
    bus: ServoBus,
    channel: TargetChannel,
    *,
    rate_hz: float | None = None,
    tolerant: bool = False,
    dry_run: bool = False,
    given_up: Mapping[int, str] | None = None,
    switched_off: Collection[int] = (),
) -> Bridge:
    """The bridge with all rules of the face's YAML. rate_hz: default the face's."""
    return Bridge(
        bus,
        face.joints(),
        channel,
        BridgeSettings(
            rate_hz=rate_hz or face.rate_hz,
            stale=StaleRule(face.stale.hold_s, face.stale.neutral_s, face.stale.limp_s),
            tracking=TrackingRule(face.tracking.error_deg, face.tracking.after_s),
            prevent=prevent_rules(face),
            tolerant=tolerant,
            dry_run=dry_run,
            given_up=given_up or {},
            switched_off=switched_off,
        ),
    )


def mouth_rules(face: FaceSettings) -> tuple[CouplingRule, ...]:
    """The same rules as a calibration keeps them, in the order of the mouth's servos alone.

    Necks and eyes count as at rest: a calibration moves the mouth only.
    """
    return tuple(
        CouplingRule(np.array(rule.factors(face.mouth_servos)), rule.above) for rule in face.prevent
    )


def port_opener(port: str, baud_rate: int) -> Callable[[], Transport]:
    """Opens the port anew each time it is called, while the same adapter is there."""
    return SameAdapter(port, baud_rate)


def servo_memories(face: FaceSettings) -> tuple[ServoMemory | None, ...]:
    """What the mouth's servos keep in themselves; nothing for simulated ones in memory.

    Opens the port for this alone. Raises PortError, and ServoError where a servo differs from the
    face's YAML; None for one that does not answer.
    """
    if face.bus.kind == "simulated" or face.bus.port is None:
        return ()
    from firmware_bridge.dynamixel.mounting import read_identities

    mouth = [servo for servo in mounted_servos(face) if servo.joint.name in face.mouth_servos]
    said = read_identities(port_opener(face.bus.port, face.bus.baud_rate), mouth)
    keys = [field.name for field in fields(ServoMemory)]
    return tuple(
        None if each is None else ServoMemory(*(each.eeprom[key] for key in keys)) for each in said
    )


def bus_for(face: FaceSettings, clock: Clock, *, strict: bool = True) -> ServoBus:
    """The bus that the face's YAML asks for; use it as a context manager."""
    if face.bus.kind == "simulated" or face.bus.port is None:
        return SimulatedBus(face.joints(), clock)
    from firmware_bridge.dynamixel.bus import DynamixelBus

    opener = port_opener(face.bus.port, face.bus.baud_rate)
    watchdog_s = max(3.0 / face.rate_hz, 0.1)
    servos = mounted_servos(face)
    remark = partial(_slow_adapter, face, face.bus.port)
    if face.bus.backend == "own":
        return DynamixelBus(
            servos, opener, watchdog_s=watchdog_s, strict=strict, adapter_remark=remark
        )
    from firmware_bridge.dynamixel.wire.sdk_line import SdkLine, SdkTransport

    port, rate = face.bus.port, face.bus.baud_rate
    return DynamixelBus(
        servos,
        lambda: SdkTransport(port, rate),
        watchdog_s=watchdog_s,
        strict=strict,
        make_line=SdkLine,
        adapter_remark=remark,
    )


def _slow_adapter(face: FaceSettings, port: str) -> str | None:
    """Why the adapter at an open port cannot do the face's rate; None when it can."""
    timer_ms = latency_timer_ms(port)
    return slow_adapter(len(face.servos), face.bus.baud_rate, face.rate_hz, timer_ms)


def simulated_wire(face: FaceSettings) -> tuple["DynamixelBus", ManualClock]:
    """The face's servos simulated to the byte, in memory, and the clock that moves them."""
    from firmware_bridge.dynamixel.bus import DynamixelBus
    from firmware_bridge.simulator.chain import chain_for
    from firmware_bridge.simulator.ports import MemoryTransport

    servos, clock = mounted_servos(face), ManualClock()
    chain = chain_for(servos, face.bus.baud_rate)
    return DynamixelBus(servos, lambda: MemoryTransport(chain, clock, face.bus.baud_rate)), clock


@dataclass(frozen=True, slots=True)
class Face:
    """One robot face and everything that belongs to it, checked against one another.

    calibration: of the mouth's servos, with the face's rules between joints. folder: of the YAML;
    None: a shipped face.
    """

    settings: FaceSettings
    model: FaceModel
    calibration: Calibration
    joints: tuple[Joint, ...]
    folder: Path | None = None


def load_settings(config: str) -> tuple[FaceSettings, Path | None]:
    """A shipped face by its name, or a YAML file by its path, and the folder of that file."""
    if config.endswith((".yaml", ".yml")) or "/" in config:
        path = Path(config)
        return load_face(path), path.parent
    return load_shipped_face(config), None


def assemble_face(config: str, model_path: Path | None) -> Face:
    """Load a face by name or path; refuse parts that were not made for one another.

    Raises SettingsError, ModelError or CalibrationError, each with one line for each mistake.
    """
    return assembled_face(*load_settings(config), model_path)


def assembled_face(settings: FaceSettings, folder: Path | None, model_path: Path | None) -> Face:
    """The face of settings that were read. folder: of their YAML; None: a shipped face.

    Raises ModelError or CalibrationError.
    """
    model = load_face_model(model_path)
    file = calibration_file(settings, folder)
    calibration = parse_calibration(file.read_text(encoding="utf-8"), file.name)
    check_calibration(calibration, model, list(settings.mouth_servos), settings.checksum)
    check_servo_models(calibration, [servo.model for servo in settings.mouth_servos.values()])
    kept = replace(calibration, rules=mouth_rules(settings))
    return Face(settings, model, kept, settings.joints(), folder)


def settings_at_port(settings: FaceSettings, port: str) -> FaceSettings:
    """The same face with its servos at a serial port."""
    bus = settings.bus.model_copy(update={"kind": "dynamixel", "port": port})
    return settings.model_copy(update={"bus": bus})


def check_servos(face: Face) -> None:
    """Ask the servos, if there are any, whether they are still as they were calibrated.

    Raises CalibrationError with the remedy, and what `servo_memories` raises.
    """
    if face.calibration.origin.servo_memories:
        memories = servo_memories(face.settings)
        if memories:
            check_servo_memories(face.calibration, memories)
