"""The live pipeline from sound to servo goals in one process (the street): making and tick.

Live running and `replay` use the same pipeline; they differ in the clock and in the observers.
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
    """The live pipeline from sound to servo goals: speech side and bridge in one process."""

    def __init__(self, side: SpeechSide, bridge: Bridge, rest: Array) -> None:
        """Join both sides; nothing starts. rest: the face (n_components,) of a mouth at rest."""
        self.side = side
        self.speech = side.speech
        self.bridge = bridge
        self._rest = rest

    def begin(self, zero_s: float) -> None:
        """Begin the sound at monotonic `zero_s`, without waiting for servos."""
        self.side.begin(zero_s)

    def tick(self, time_s: float, late: int) -> StreetTick:
        """Advance speech and servos to monotonic `time_s`; return face shown and servo report.

        late: ticks missed just before this one.
        """
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
        """Tick only the bridge as a stopped face goes to rest; return its report, mouth closed.

        All speech that was not heard yet is dropped. late: ticks missed just before this one.
        """
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
    """Return the live pipeline from an entered source, through a recogniser, to an entered bus.

    rate_hz: ticks a second. Nothing starts yet.
    """
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
