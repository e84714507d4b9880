"""Puts a street together from files: face, model, calibration, recogniser, bus."""

from dataclasses import dataclass, field
from pathlib import Path

from calibration.calibration import Calibration, check_calibration
from calibration.calibration_file import parse_calibration
from firmware_bridge.bridge import Bridge
from firmware_bridge.bus import ServoBus
from firmware_bridge.channel import MemoryTargetChannel
from firmware_bridge.clock import Clock
from firmware_bridge.joints import Joint
from firmware_bridge.simulator.bus import SimulatedBus
from lipservo.pipeline import Speech, Street, Synthesizer
from lipservo.settings import FaceSettings, calibration_file, load_face, load_shipped_face
from lipsync.animpho.live import LIVE_STRATEGY, LiveSynthesizer, Style, StyleError
from lipsync.animpho.model import FaceModel, load_model, load_shipped_model
from lipsync.animpho.selection import STRATEGIES
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
    check_calibration(calibration, model, list(settings.servos), settings.checksum)
    return Face(settings, model, calibration, settings.joints())


def make_bus(face: Face, clock: Clock) -> ServoBus:
    """The bus that the face's YAML asks for; use it as a context manager."""
    return SimulatedBus(face.joints, clock)


@dataclass(frozen=True, slots=True)
class Manner:
    """How phonemes become motion: the strategy by name, and the style of ours."""

    strategy: str = LIVE_STRATEGY
    style: Style = field(default_factory=Style)

    def __post_init__(self) -> None:
        known = (LIVE_STRATEGY, *STRATEGIES)
        if self.strategy not in known:
            raise StyleError(f"unknown strategy {self.strategy!r}; known here: {', '.join(known)}")


def make_synthesizer(model: FaceModel, manner: Manner) -> Synthesizer:
    """Ours, or the paper's with one of its two selections."""
    if manner.strategy == LIVE_STRATEGY:
        return LiveSynthesizer(model, manner.style)
    return PublishedSynthesizer(model, STRATEGIES[manner.strategy])


def make_street(
    face: Face, source: AudioSource, bus: ServoBus, rate_hz: float, zero_s: float, manner: Manner
) -> Street:
    """Everything between an entered source and an entered bus; the sound begins at `zero_s`."""
    channel = MemoryTargetChannel()
    synthesizer = make_synthesizer(face.model, manner)
    speech = Speech(source, make_recognizer(), synthesizer, face.calibration, channel)
    return Street(speech, Bridge(bus, face.joints, channel, rate_hz=rate_hz), zero_s)


def make_recognizer() -> LiveRecognizer:
    """The live recogniser."""
    from lipsync.recognition.allphone import PocketsphinxRecognizer

    return PocketsphinxRecognizer()
