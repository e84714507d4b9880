"""Loading of a face (settings, model, calibration) and making of its servo bus and bridge."""

import os
from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields, replace
from itertools import compress
from pathlib import Path

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
from firmware_bridge.bus_kinds import bus_kind
from firmware_bridge.clock import Clock, ManualClock
from firmware_bridge.gate.limits import PreventRule
from firmware_bridge.gate.ramp import StaleRule
from firmware_bridge.gate.tracking import TrackingRule
from firmware_bridge.joints import Joint
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.report import BridgeSettings
from firmware_bridge.loop.targets import TargetChannel
from firmware_bridge.process.port_record import note_port
from lipservo.health.health_log import kept_pulses_path
from lipservo.settings.settings import FaceSettings, calibration_file, load_face, load_shipped_face
from lipsync.face.model import FaceModel
from lipsync.face.model import load_face as load_face_model


def prevent_rules(face: FaceSettings) -> list[PreventRule]:
    """Return the face's upper limits on weighted sums of joint angles, for the safety gate."""
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
    """Return a bridge: the loop that sends targets from `channel` through the safety gate to `bus`.

    rate_hz: ticks a second; None: the face's. tolerant: servos that cannot be enabled at the start
    are tried again in later ticks; False: all start or none. dry_run: servos are read and never
    moved. given_up: reasons for servos that stay limp, by index. switched_off: indices of servos
    that a person switched off.
    """
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
    """Return the face's limits on sums of joint angles as coupling rules of the mouth's servos.

    Necks and eyes count as at rest: a calibration moves the mouth only.
    """
    return tuple(
        CouplingRule(np.array(rule.factors(face.mouth_servos)), rule.above) for rule in face.prevent
    )


def servo_memories(face: FaceSettings) -> tuple[ServoMemory | None, ...]:
    """Read the settings stored in the mouth's servos; () if no servo of the face stores any.

    One entry for each mouth servo, in the YAML's order; None: it does not answer, or stores none.
    Opens and closes the ports. Raises PortError, and ServoError where a servo differs from the
    face's YAML.
    """
    keys = [field.name for field in fields(ServoMemory)]
    memory_of: dict[str, ServoMemory | None] = {}
    for one in face.alone.values():
        is_mouth = [name in one.mouth_servos for name in one.servos]
        if not any(is_mouth):
            continue
        wiring = one.wiring
        mouth_wiring = replace(
            wiring,
            joints=tuple(compress(wiring.joints, is_mouth)),
            servos=tuple(compress(wiring.servos, is_mouth)),
        )
        memories = one.bus_kind.memories(mouth_wiring)
        # Empty where servos of this kind store no settings.
        for joint, memory in zip(mouth_wiring.joints, memories, strict=False):
            servo_memory = None if memory is None else ServoMemory(*(memory[key] for key in keys))
            memory_of[joint.name] = servo_memory
    return tuple(memory_of.get(name) for name in face.mouth_servos) if memory_of else ()


def bus_for(
    face: FaceSettings, clock: Clock, *, strict: bool = True, may_jump: bool = False
) -> ServoBus:
    """Return the servo bus of the face, or one that joins its buses; the caller must enter it.

    strict: opening fails if a servo is missing; False: servos may be missing. may_jump: servos of
    unknown position may jump to neutral; a person must have agreed before.
    """
    if not face.buses:
        wiring = replace(face.wiring, may_jump=may_jump)
        if face.servo_port is not None:
            # Recorded, so that torque at the port can be switched off without the face's settings.
            note_port(face.bus)
            # The file in which the last pulses of hobby servos are kept.
            pulses_file = kept_pulses_path(face.name, face.servo_port, os.environ)
            wiring = replace(wiring, kept=pulses_file)
        return face.bus_kind.open(wiring, clock, strict=strict)
    if face.capabilities.in_memory:
        # All simulated servos share one bus, with one clock and no thread: the same sound gives the
        # same trace.
        wiring = replace(face.wiring, capabilities=face.capabilities)
        return bus_kind(wiring.settings.kind).open(wiring, clock)
    buses = {
        name: bus_for(one, clock, strict=strict, may_jump=may_jump)
        for name, one in face.alone.items()
    }
    from firmware_bridge.several_buses import SeveralBuses

    return SeveralBuses(buses, face.bus_of, clock, face.rate_hz)


def simulated_wire(face: FaceSettings) -> tuple[ServoBus, ManualClock]:
    """Return (bus, its clock) of the face's servos, simulated in memory down to each byte sent.

    The face must have one bus.
    """
    bus, clock = face.bus_kind.simulator().simulated_wire(face.wiring)
    return bus, clock


@dataclass(frozen=True, slots=True)
class Face:
    """One robot face with settings, model, calibration and joints, checked against one another.

    calibration: of the mouth's servos, with the face's rules between joints. folder: of the YAML;
    None: a shipped face.
    """

    settings: FaceSettings
    model: FaceModel
    calibration: Calibration
    joints: tuple[Joint, ...]
    folder: Path | None = None


def load_settings(config: str) -> tuple[FaceSettings, Path | None]:
    """Load a shipped face by name or a YAML file by path; return settings and the YAML's folder.

    The folder is None for a shipped face. Raises SettingsError.
    """
    if config.endswith((".yaml", ".yml")) or "/" in config:
        path = Path(config)
        return load_face(path), path.parent
    return load_shipped_face(config), None


def assemble_face(config: str, model_path: Path | None) -> Face:
    """Load the face `config` by name or YAML path; refuse a model or calibration that does not fit.

    model_path: the face model's file; None: the shipped one. Raises SettingsError, ModelError or
    CalibrationError, each with one line for each mistake.
    """
    return assembled_face(*load_settings(config), model_path)


def assembled_face(settings: FaceSettings, folder: Path | None, model_path: Path | None) -> Face:
    """Return the face of loaded settings, with model and calibration loaded and checked.

    folder: of the settings' YAML; None: a shipped face. model_path: the face model's file; None:
    the shipped one. Raises ModelError or CalibrationError.
    """
    model = load_face_model(model_path)
    file = calibration_file(settings, folder)
    calibration = parse_calibration(file.read_text(encoding="utf-8"), file.name)
    check_calibration(calibration, model, list(settings.mouth_servos), settings.checksum)
    check_servo_models(calibration, [servo.make or "" for servo in settings.mouth_servos.values()])
    with_rules = replace(calibration, rules=mouth_rules(settings))
    return Face(settings, model, with_rules, settings.joints(), folder)


def check_servos(face: Face) -> None:
    """Raise CalibrationError, with a remedy, if settings in servos changed since calibration.

    Does nothing if the calibration was made without servos. Raises PortError, and ServoError where
    a servo differs from the face's YAML.
    """
    if face.calibration.origin.servo_memories:
        memories = servo_memories(face.settings)
        if memories:
            check_servo_memories(face.calibration, memories)
