"""Puts a street together from files: face, model, calibration, recogniser, bus."""

from dataclasses import dataclass
from pathlib import Path

from calibration.calibration import Calibration, check_calibration
from calibration.calibration_file import parse_calibration
from firmware_bridge.bridge import Bridge
from firmware_bridge.bus import ServoBus
from firmware_bridge.channel import MemoryTargetChannel
from firmware_bridge.clock import Clock
from firmware_bridge.joints import Joint
from firmware_bridge.simulator.bus import SimulatedBus
from lipservo.pipeline import Speech, Street
from lipservo.settings import FaceSettings, calibration_file, load_face, load_shipped_face
from lipsync.animpho.model import FaceModel, load_model, load_shipped_model
from lipsync.animpho.synthesizer import PublishedSynthesizer
from lipsync.audio.source import AudioSource
from lipsync.phonemes import LiveRecognizer


@dataclass(frozen=True, slots=True)
class Face:
    """One robot face and everything that belongs to it, checked against one another."""

    settings: FaceSettings
    model: FaceModel
    calibration: Calibration
    joints: tuple[Joint, ...]


def load_settings(config: str) -> tuple[FaceSettings, Path | None]:
    """A shipped face by its name, or a YAML file by its path, and the folder of that file."""
    if config.endswith((".yaml", ".yml")) or "/" in config:
        path = Path(config)
        return load_face(path), path.parent
    return load_shipped_face(config), None


def load_face_model(path: Path | None) -> FaceModel:
    """The model at a path; None: the shipped one."""
    return load_shipped_model() if path is None else load_model(path)


def assemble_face(config: str, model_path: Path | None) -> Face:
    """Load a face by name or path; refuse parts that were not made for one another.

    Raises SettingsError, ModelError or CalibrationError, each with one line for each mistake.
    """
    settings, folder = load_settings(config)
    model = load_face_model(model_path)
    file = calibration_file(settings, folder)
    calibration = parse_calibration(file.read_text(encoding="utf-8"), file.name)
    check_calibration(calibration, model, list(settings.mouth_servos), settings.checksum)
    whole = calibration.for_servos(list(settings.servos))
    return Face(settings, model, whole, settings.joints())


def make_bus(face: Face, clock: Clock) -> ServoBus:
    """The bus that the face's YAML asks for; use it as a context manager."""
    return SimulatedBus(face.joints, clock)


def make_street(
    face: Face, source: AudioSource, bus: ServoBus, rate_hz: float, zero_s: float
) -> Street:
    """Everything between an entered source and an entered bus; the sound begins at `zero_s`."""
    channel = MemoryTargetChannel()
    synthesizer = PublishedSynthesizer(face.model)
    speech = Speech(source, make_recognizer(), synthesizer, face.calibration, channel)
    return Street(speech, Bridge(bus, face.joints, channel, rate_hz=rate_hz), zero_s)


def make_recognizer() -> LiveRecognizer:
    """The live recogniser."""
    from lipsync.recognition.allphone import PocketsphinxRecognizer

    return PocketsphinxRecognizer()
