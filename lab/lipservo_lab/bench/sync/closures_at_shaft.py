"""Lips that meet at the shafts of a face's servos, beside the same face on Dynamixels.

The clip of `make run` goes through recogniser, synthesiser, calibration, plan and gate to servos
simulated to the byte. What counts is where their shafts stand, not what they were sent.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Final

import numpy as np

from calibration.simulated.practice_robot import markers_of_face
from firmware_bridge.clock import ManualClock, ticks
from firmware_bridge.dynamixel.bus import DynamixelBus
from firmware_bridge.dynamixel.control_table import servo_models
from firmware_bridge.dynamixel.mounting import MountedServo
from firmware_bridge.joints import Joint
from firmware_bridge.several_buses import SeveralBuses
from firmware_bridge.simulator.chain import chain_for
from firmware_bridge.simulator.ports import MemoryTransport, WatchedServos
from lipservo.calibrating.calibration_setup import CalibrationSetup
from lipservo.runtime.motion_options import MotionOptions, make_synthesizer
from lipservo.runtime.servos.assembly import Face, assemble_face, simulated_wire
from lipservo.runtime.street import make_street
from lipservo.settings.settings import FaceSettings
from lipservo_lab.evaluation.recognition.heard_motion import recognize_file
from lipsync.animpho.units import load_face_with_animphos
from lipsync.arrays import Array
from lipsync.audio.file import FileSource
from lipsync.errors import UserError
from lipsync.markers import MARKERS_47
from lipsync.phonemes import PhonemeEvent
from lipsync.recognition.recognizers import make_recognizer

_BILABIALS: Final = ("P", "B", "M")
#: A closure counts from so long before its phoneme until so long after it.
_AROUND_S: Final = 0.06
#: Lips that come so near to where the angles of closed lips would bring them are closed.
_REACHED_MM: Final = 0.5
_AFTER_S: Final = 0.5
#: Until the last of staggered servos has come on and has caught up.
_COMES_ON_S: Final = 0.5
_BAUD_RATE: Final = 1_000_000
#: Threads of several buses are waited for, however busy the computer is: so many ticks a second
#: would be as slow as that.
_PATIENT_HZ: Final = 0.1


@dataclass(frozen=True, slots=True)
class Shown:
    """The clip as played on some servos, tick by tick.

    sound_s (n,): sound time that is shown; faces (n, n_components): faces that should be shown;
    shafts_deg (n, n_mouth): where the shafts of the mouth's joints stood.
    """

    sound_s: Array
    faces: Array
    shafts_deg: Array


def closures_at_shaft(name: str) -> dict[str, float]:
    """Count the clip's closures (P, B, M) that the servos of a face reach, and Dynamixels instead.

    A closure is reached if, during the phoneme or 60 ms beside it, the lips come within 0.5 mm of
    the gap that exact angles would give them for the face with the smallest gap in that time.
    name: of the face or its YAML. `closures_at_shaft_share`: our servos' count over that of the
    Dynamixels.
    """
    face = assemble_face(name, None)
    with resources.as_file(resources.files("lipservo.clips") / "welcome.flac") as clip:
        events = recognize_file(make_recognizer(), clip).events
        closures = [each for each in events if each.phoneme in _BILABIALS]
        n_reached = _n_reached(face, _play_clip(face, _face_servos(face.settings), clip), closures)
        n_on_dynamixel = _n_reached(face, _play_clip(face, _dynamixels(face), clip), closures)
    return {
        "closures": len(closures),
        "closures_at_shaft": n_reached,
        "closures_at_shaft_on_dynamixel": n_on_dynamixel,
        "closures_at_shaft_share": n_reached / max(1, n_on_dynamixel),
    }


class _JointClock(ManualClock):
    """A virtual clock that advances the clocks of several buses with it."""

    def __init__(self, clocks: Sequence[ManualClock]) -> None:
        super().__init__()
        self._clocks = tuple(clocks)

    def sleep_until(self, time_s: float) -> None:
        """Advance all clocks to a time; a clock that is later already stays."""
        super().sleep_until(time_s)
        for clock in self._clocks:
            clock.sleep_until(time_s)


def _face_servos(settings: FaceSettings) -> WatchedServos:
    """Return the simulated servos of the face's YAML, on all of its buses.

    Raises UserError for a bus whose simulator does not give the shafts' angles.
    """
    if settings.buses:
        return _on_several_buses(settings)
    watch = getattr(settings.bus_kind.simulator(), "watched_servos", None)
    if watch is not None:
        watched: WatchedServos = watch(settings.wiring)
        return watched
    bus, clock = simulated_wire(settings)
    if not bus.capabilities.place:
        raise UserError(f"{settings.name}: its simulated servos do not tell their angles")
    return WatchedServos(bus, clock, None, lambda: bus.feedback().positions_deg, lambda: True)


def _on_several_buses(settings: FaceSettings) -> WatchedServos:
    """Return the servos of a face with several buses as one bus; each bus keeps its own clock."""
    parts = {name: _face_servos(alone) for name, alone in settings.alone.items()}
    clock = _JointClock([bus_servos.clock for bus_servos in parts.values()])
    buses = {name: bus_servos.bus for name, bus_servos in parts.items()}
    bus = SeveralBuses(buses, settings.bus_of, clock, _PATIENT_HZ)
    at = {name: np.flatnonzero(np.array(settings.bus_of) == name) for name in parts}

    def shafts_deg() -> Array:
        all_deg = np.full(len(settings.servos), np.nan)
        for name, bus_servos in parts.items():
            all_deg[at[name]] = bus_servos.shafts_deg()
        return all_deg

    return WatchedServos(bus, clock, None, shafts_deg, lambda: True)


def _dynamixels(face: Face) -> WatchedServos:
    """Return simulated servos of the same face, an XL330-M288 in place of each servo."""
    model, clock = servo_models()["XL330-M288"], ManualClock()
    servos = [
        MountedServo(
            Joint(joint.name, n, joint.min_deg, joint.max_deg, joint.max_speed_deg_s), model
        )
        for n, joint in enumerate(face.joints, start=1)
    ]
    chain = chain_for(servos, _BAUD_RATE)
    bus = DynamixelBus(servos, lambda: MemoryTransport(chain, clock, _BAUD_RATE))
    return WatchedServos(bus, clock, chain, lambda: bus.feedback().positions_deg, lambda: True)


def _play_clip(face: Face, servos: WatchedServos, clip: Path) -> Shown:
    """Play a clip on simulated servos; return faces and shafts of each tick.

    Until `_AFTER_S` after the clip's end, on a virtual clock.
    """
    bus, clock, rate_hz = servos.bus, servos.clock, face.settings.rate_hz
    mouth_indices = [list(face.settings.servos).index(each) for each in face.settings.mouth_servos]
    synthesizer = make_synthesizer(face.model, MotionOptions())
    sound_s, faces, shafts_deg = [], [], []
    with FileSource(clip) as source, bus:
        street = make_street(face, source, bus, rate_hz, make_recognizer(), synthesizer)
        street.bridge.start()
        clock.sleep_until(clock.now() + _COMES_ON_S * len(face.joints))
        street.begin(clock.now())
        for time_s, late in ticks(clock, rate_hz):
            tick_result = street.tick(time_s, late)
            if tick_result.sound_s > (source.duration_s or 0.0) + _AFTER_S:
                break
            sound_s.append(tick_result.sound_s)
            faces.append(tick_result.frame.coefficients)
            shafts_deg.append(servos.shafts_deg()[mouth_indices])
    return Shown(np.array(sound_s), np.array(faces), np.array(shafts_deg))


def _gap_mm(markers_mm: Array) -> Array:
    """Return the gap of the inner lips' middle points, (n,) mm, of markers (n, 47, 3)."""
    upper, lower = markers_mm[:, MARKERS_47.upper_lip], markers_mm[:, MARKERS_47.lower_lip]
    return np.asarray(upper[:, 1] - lower[:, 1])


def _n_reached(face: Face, shown: Shown, closures: list[PhonemeEvent]) -> int:
    """Return how many of the closures the shafts reach, as `closures_at_shaft` defines it.

    shown: the clip as played. A closure during which nothing was shown is not reached.
    """
    servos = CalibrationSetup(face.settings, load_face_with_animphos(), quiet=True).servos
    markers_of = markers_of_face(face.model.markers_mm(face.model.rest[None])[0], servos)
    gap_mm = _gap_mm(face.model.markers_mm(shown.faces))
    shown_mm = _gap_mm(markers_of(shown.shafts_deg))
    n_reached = 0
    for event in closures:
        end_s = np.inf if event.end_s is None else event.end_s + _AROUND_S
        in_closure = (event.start_s - _AROUND_S <= shown.sound_s) & (shown.sound_s <= end_s)
        if in_closure.any():
            nearest = int(np.argmin(np.where(in_closure, gap_mm, np.inf)))
            closed_deg = face.calibration.positions_deg(shown.faces[nearest])
            closed_mm = _gap_mm(markers_of(closed_deg[None]))[0]
            n_reached += bool(shown_mm[in_closure].min() <= closed_mm + _REACHED_MM)
    return n_reached
