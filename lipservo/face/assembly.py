"""Puts a face together from files: settings, model, calibration, bus."""

from dataclasses import dataclass, replace
from pathlib import Path

from calibration.calibration import (
    Calibration,
    check_calibration,
    check_servo_memories,
    check_servo_models,
)
from calibration.files.calibration_file import parse_calibration
from firmware_bridge.bus import ServoBus
from firmware_bridge.clock import Clock
from firmware_bridge.joints import Joint
from lipservo.face.servos import bus_for, mouth_rules, servo_memories
from lipservo.settings.settings import FaceSettings, calibration_file, load_face, load_shipped_face
from lipsync.face.model import FaceModel
from lipsync.face.model import load_face as load_face_model


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
    settings, folder = load_settings(config)
    model = load_face_model(model_path)
    file = calibration_file(settings, folder)
    calibration = parse_calibration(file.read_text(encoding="utf-8"), file.name)
    check_calibration(calibration, model, list(settings.mouth_servos), settings.checksum)
    check_servo_models(calibration, [servo.model for servo in settings.mouth_servos.values()])
    kept = replace(calibration, rules=mouth_rules(settings))
    return Face(settings, model, kept, settings.joints(), folder)


def at_port(face: Face, port: str | None) -> Face:
    """The same face with its servos at a serial port; None: where its YAML says."""
    return face if port is None else replace(face, settings=settings_at_port(face.settings, port))


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


def make_bus(face: Face, clock: Clock) -> ServoBus:
    """The bus that the face's YAML asks for; use it as a context manager."""
    return bus_for(face.settings, clock)
