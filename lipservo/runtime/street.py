"""One tick of the street: phonemes in, servo goals out; and the loop around it.

Live running and `replay` share it; they differ in the clock and in who watches.
"""

from firmware_bridge.bus import ServoBus
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.targets import MemoryTargetChannel
from lipservo.runtime.servos.assembly import Face, bridge_for
from lipservo.runtime.speech.speech_side import SpeechSide, make_speech_side
from lipservo.runtime.status.street_tick import StreetTick
from lipsync.arrays import Array
from lipsync.audio.source import AudioSource
from lipsync.face.frame import Frame, Synthesizer
from lipsync.phonemes import SILENCE, LiveRecognizer


class Street:
    """Speech and bridge in one process, joined by a target channel."""

    def __init__(self, side: SpeechSide, bridge: Bridge, rest: Array) -> None:
        """rest: the face (n_components,) of a mouth at rest."""
        self.side = side
        self.speech = side.speech
        self.bridge = bridge
        self._rest = rest

    def begin(self, zero_s: float) -> None:
        """The sound begins at monotonic `zero_s`."""
        self.side.begin(zero_s)

    def start(self, now_s: float) -> float:
        """The servos get torque at monotonic `now_s`; when the sound begins."""
        return self.side.start(now_s)

    def tick(self, time_s: float, late: int) -> StreetTick:
        """Run all that is due at monotonic grid time `time_s`."""
        self.side.advance(time_s)
        report = self.bridge.tick(time_s, late)
        feedback = self.bridge.feedback
        if feedback is not None:
            self.side.note_servos(feedback.time_s, feedback.positions_deg)
        sound_s, phoneme, frame = self.side.shown(time_s)
        captured_s = self.speech.captured_s(time_s)
        return StreetTick(
            sound_s, phoneme, frame, report, captured_s, self.speech.hearing, self.speech.moved_by
        )

    def rest(self, time_s: float, late: int) -> StreetTick:
        """The same once the face is stopped: nothing is heard any more, the mouth goes to rest."""
        self.side.fall_silent()
        report = self.bridge.tick(time_s, late)
        sound_s = self.speech.sound_time_s(time_s)
        return StreetTick(sound_s, SILENCE, Frame(sound_s, self._rest), report)


def make_street(
    face: Face,
    source: AudioSource,
    bus: ServoBus,
    rate_hz: float,
    recognizer: LiveRecognizer,
    synthesizer: Synthesizer,
) -> Street:
    """Everything between an entered source and an entered bus, with a recogniser in it."""
    channel = MemoryTargetChannel()
    side = make_speech_side(
        face,
        source,
        recognizer,
        synthesizer,
        channel,
        start_s=bus.capabilities.start_s(len(face.joints)),
    )
    bridge = bridge_for(face.settings, bus, channel, rate_hz=rate_hz)
    return Street(side, bridge, face.model.rest)
