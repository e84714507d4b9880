"""A robot that speaks on a virtual clock: its servos simulated to the byte, its loudspeaker too.

What the encoders say and which sample left the loudspeaker when are both kept, on one clock.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from calibration.simulated.face import marker_positions_mm, simulated_face
from firmware_bridge.loop.life_cycle import LifeCycle
from lipservo.face.assembly import assemble_face
from lipservo.face.servos import simulated_wire
from lipservo.street.motion_options import (
    MotionOptions,
    make_recognizer,
    make_synthesizer,
    no_recognizer,
)
from lipservo.street.street import make_street
from lipservo_lab.bench.sync.simulated_loudspeaker import SimulatedLoudspeaker
from lipsync.arrays import Array
from lipsync.audio.playout import Playout
from lipsync.audio.playout_stream import PlayoutStream
from lipsync.audio_block import AudioBlock
from lipsync.markers import MARKERS_47
from lipsync.motion.still_motion import StillMotion
from lipsync.offline.performance import Performance
from lipsync.phonemes import SILENCE, LiveRecognizer, PhonemeEvent, PhonemeUpdate
from lipsync.recognition.network import LATENCY_S
from lipsync.text_to_speech.spoken_text import SpokenText

#: A face of ten servos whose geometry is known, so that encoders tell how far its lips are apart.
FACE: Final = "face_sim"
RATE_HZ: Final = 100.0


@dataclass(frozen=True, slots=True)
class Watched:
    """What was seen in each tick: times_s (n,), encoder angles (n, n_servos), lip gap in mm (n,).

    zero_s: where the sound's timeline begins, on the same clock.
    """

    times_s: Array
    encoders_deg: Array
    gap_mm: Array
    zero_s: float


class Deaf:
    """A recogniser that hears silence, and says so as late as the network would."""

    latency_s = LATENCY_S

    def __init__(self) -> None:
        self.reset()

    def feed(self, block: AudioBlock) -> None:
        """Time goes on."""
        self._heard_s = block.end_s

    def updates(self) -> list[PhonemeUpdate]:
        """All was silence."""
        final_s = max(0.0, self._heard_s - LATENCY_S)
        silence = (PhonemeEvent(SILENCE, 0.0, None),)
        return [PhonemeUpdate(final_s, self._heard_s, final_s, silence)]

    def reset(self) -> None:
        """Begin anew."""
        self._heard_s = 0.0


class SpeakingRobot:
    """One face with its loudspeaker; `run` lets time pass."""

    def __init__(
        self,
        loudspeaker: SimulatedLoudspeaker | None = None,
        *,
        hears: bool = False,
        rate_hz: float = RATE_HZ,
        performance: Performance | None = None,
    ) -> None:
        """rate_hz: ticks a second.

        hears: whether there is a recogniser; else only known phonemes move the mouth, or what was
        rendered, where there is a performance.
        """
        face = assemble_face(FACE, None)
        self.loudspeaker = loudspeaker or SimulatedLoudspeaker()
        self.playout = Playout(self.loudspeaker)
        self._bus, self.clock = simulated_wire(face.settings)
        self._neutral_mm = face.model.markers_mm(face.model.rest[None])[0]
        self._names = [joint.name for joint in face.joints]
        recognizer: LiveRecognizer = make_recognizer() if hears else Deaf()
        synthesizer = make_synthesizer(face.model, MotionOptions())
        if performance is not None:
            recognizer = no_recognizer()
            synthesizer = StillMotion(face.model.rest)
        self.street = make_street(face, self.playout, self._bus, rate_hz, recognizer, synthesizer)

    def run(self, until_s: float, act: Callable[[float], None] | None = None) -> Watched:
        """From the first torque until so many seconds after the timeline began.

        act: called in each tick with the seconds since then.
        """
        times_s: list[float] = []
        encoders_deg: list[Array] = []
        with self._bus, LifeCycle(self.street.bridge, self.clock) as life:
            life.start()
            zero_s = self.clock.now()
            self.loudspeaker.advance(zero_s)
            self.street.begin(zero_s)
            for time_s, late in life.ticks():
                self.loudspeaker.advance(time_s)
                if act is not None:
                    act(time_s - zero_s)
                self.street.tick(time_s, late)
                times_s.append(self.clock.now())
                encoders_deg.append(self._bus.feedback().positions_deg)
                if time_s - zero_s >= until_s:
                    break
        seen_deg = np.array(encoders_deg)
        return Watched(np.array(times_s), seen_deg, self._gap_mm(seen_deg), zero_s)

    def _gap_mm(self, positions_deg: Array) -> Array:
        """(n, n_servos) -> (n,): how far the inner lips are apart, by the face's geometry."""
        face = simulated_face(self._neutral_mm, self._names)
        markers_mm = marker_positions_mm(face, positions_deg)
        upper, lower = markers_mm[:, MARKERS_47.upper_lip], markers_mm[:, MARKERS_47.lower_lip]
        return np.asarray(upper[:, 1] - lower[:, 1])


def spoken_stream(text: SpokenText, playout: Playout, *, knows: bool) -> PlayoutStream:
    """A whole text as a stream that has ended. knows: with its phonemes."""
    known = text.phonemes if knows else ()
    stream = PlayoutStream("text", text.sample_rate_hz, playout.output_rate_hz, known)
    stream.push(text.samples)
    stream.end()
    return stream
