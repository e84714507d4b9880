"""A robot that speaks on a virtual clock: its servos simulated to the byte, its loudspeaker too.

What the encoders say and which sample left the loudspeaker when are both kept, on one clock.

A loudspeaker without sound, on a virtual clock: its rate is a little wrong, its reports too.

What of the timeline left it when is recorded, so that lips can be compared with what was truly
played.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from calibration.simulated.face import marker_positions_mm, simulated_face
from firmware_bridge.loop.life_cycle import LifeCycle
from lipservo.runtime.motion_options import MotionOptions, make_synthesizer
from lipservo.runtime.servos.assembly import assemble_face, simulated_wire
from lipservo.runtime.street import make_street
from lipsync.arrays import Array
from lipsync.audio.loudspeaker import PositionReport, SampleRing
from lipsync.audio.playout import Playout
from lipsync.audio.playout_stream import PlayoutStream
from lipsync.audio_block import AudioBlock
from lipsync.markers import MARKERS_47
from lipsync.motion.still_motion import StillMotion
from lipsync.offline.performance import Performance
from lipsync.phonemes import SILENCE, LiveRecognizer, PhonemeEvent, PhonemeUpdate
from lipsync.recognition.network import LATENCY_S
from lipsync.recognition.recognizers import make_recognizer, no_recognizer
from lipsync.spoken_text import SpokenText, SpokenUnit, UnitKind
from lipsync.text_to_speech.pronunciation import pronounced_units
from lipsync.text_to_speech.synthesis import SynthesizedSpeech

Samples = NDArray[np.float32]
Seconds = NDArray[np.float64]


class SimulatedLoudspeaker:
    """A simulated `lipsync.audio.playout.Loudspeaker`; `advance` lets its time pass.

    rate_hz: samples a second by its own clock, a multiple of 100. latency_s: from taking a sample
    to playing it. skew: how much faster than nominal its clock runs, 200e-6 for 200 parts in a
    million. jitter_s: its reports are up to so much early or late, evenly distributed, and its
    callbacks come up to so much late, drawn by `rng`.
    """

    def __init__(
        self,
        rate_hz: int = 48_000,
        latency_s: float = 0.05,
        skew: float = 0.0,
        jitter_s: float = 0.0,
        rng: np.random.Generator | None = None,
    ) -> None:
        self._ring = SampleRing(rate_hz)
        self._latency_s = latency_s
        self._period_s = 0.01 / (1.0 + skew)
        self._jitter_s = jitter_s
        self._rng = np.random.default_rng(0) if rng is None else rng
        self._frames: Samples = np.zeros((rate_hz // 100, 1), dtype=np.float32)
        self._report: PositionReport | None = None
        self._now_s = 0.0
        self._callback_due_s: float | None = None  # when it asks for the next block, by its clock
        self._callback_late_s = 0.0  # so much later the callback comes
        self._stalls: list[tuple[float, float]] = []
        self._played: list[tuple[float, Samples]] = []

    #: It cannot be lost, only stand still.
    is_lost = False
    name = "simulated loudspeaker"

    @property
    def rate_hz(self) -> int:
        """Samples a second, by its own clock."""
        return self._ring.rate_hz

    @property
    def latency_s(self) -> float:
        """The least lead: the loudspeaker's latency, a block of 10 ms, and its jitter, s."""
        return self._latency_s + 0.01 + self._jitter_s

    @property
    def n_underruns(self) -> int:
        """How often samples were not written in time."""
        return self._ring.n_underruns

    def write(self, samples: Samples) -> None:
        """Append the next samples of the timeline, (n,) float32 mono."""
        self._ring.write(samples)

    def silence_rest(self) -> float:
        """Drop samples that have not been taken, as `LoudspeakerOutput.silence_rest`.

        Returns the second of the timeline from which on there is silence.
        """
        return self._ring.silence_rest(self.rate_hz // 100) / self.rate_hz

    def position(self) -> tuple[float, float] | None:
        """Return a monotonic time, with jitter, and the second of the timeline that is played then.

        None: nothing has been taken yet.
        """
        return None if self._report is None else self._report.at(self._now_s)

    def stall(self, from_s: float, until_s: float) -> None:
        """Let the loudspeaker take and play nothing between two monotonic times."""
        self._stalls.append((from_s, until_s))

    def advance(self, now_s: float) -> None:
        """Take the blocks that are due until monotonic `now_s`. The first call starts its clock."""
        self._now_s = now_s
        if self._callback_due_s is None:
            self._callback_due_s = now_s
        while self._callback_due_s + self._callback_late_s <= now_s:
            self._callback_due_s = self._end_of_stall(self._callback_due_s)
            if self._callback_due_s + self._callback_late_s > now_s:
                return
            self._take_block(self._callback_due_s)
            self._callback_due_s += self._period_s
            self._callback_late_s = self._jitter_s * float(self._rng.random())

    def played(self) -> tuple[Samples, Seconds]:
        """Return the samples (n,) taken from the timeline, and when each is played, (n,) s.

        Times are monotonic and exact. Zeros that were played for want of samples are left out.
        """
        if not self._played:
            return np.zeros(0, dtype=np.float32), np.zeros(0)
        sample_s = self._period_s * 100.0 / self.rate_hz
        times_s = [begins_s + sample_s * np.arange(len(each)) for begins_s, each in self._played]
        return np.concatenate([each for _, each in self._played]), np.concatenate(times_s)

    def _end_of_stall(self, due_s: float) -> float:
        for from_s, until_s in sorted(self._stalls):
            if from_s <= due_s < until_s:
                due_s = until_s
        return due_s

    def _take_block(self, requested_s: float) -> None:
        """Take 10 ms of samples, as a sound card's callback does; note when they leave.

        requested_s: monotonic time at which the callback was due. The times of `played` are exact,
        those that `position` reports are in error by the jitter.
        """
        position_s = self._ring.n_taken / self.rate_hz
        n_taken = self._ring.take_into(self._frames)
        leaves_s = requested_s + self._latency_s
        report_error_s = self._jitter_s * (2.0 * float(self._rng.random()) - 1.0)
        reported_s = leaves_s + report_error_s
        end_position_s = position_s + n_taken / self.rate_hz
        self._report = PositionReport(
            reported_s, position_s, reported_s + self._period_s + self._jitter_s, end_position_s
        )
        if n_taken:
            self._played.append((leaves_s, self._frames[:n_taken, 0].copy()))


#: A face of ten servos whose geometry is known, so that encoders tell how far its lips are apart.
FACE: Final = "face_sim"
RATE_HZ: Final = 100.0


@dataclass(frozen=True, slots=True)
class Watched:
    """What a robot did in each tick: times_s (n,), encoders_deg (n, n_servos), gap_mm (n,).

    gap_mm: lip gap by the encoders. zero_s: when the sound's timeline begins, on the same clock.
    """

    times_s: Array
    encoders_deg: Array
    gap_mm: Array
    zero_s: float


class Deaf:
    """A recogniser that reports silence, as late as the network would."""

    latency_s = LATENCY_S

    def __init__(self) -> None:
        self.reset()

    def feed(self, block: AudioBlock) -> None:
        """Advance the time by a block."""
        self._heard_s = block.end_s

    def updates(self) -> list[PhonemeUpdate]:
        """Return silence for all new sound."""
        final_s = max(0.0, self._heard_s - LATENCY_S)
        silence = (PhonemeEvent(SILENCE, 0.0, None),)
        return [PhonemeUpdate(final_s, self._heard_s, final_s, silence)]

    def reset(self) -> None:
        """Begin anew at time 0."""
        self._heard_s = 0.0


class SpeakingRobot:
    """One face with its loudspeaker; `run` lets time pass."""

    def __init__(
        self,
        loudspeaker: SimulatedLoudspeaker | None = None,
        *,
        is_listening: bool = False,
        rate_hz: float = RATE_HZ,
        performance: Performance | None = None,
    ) -> None:
        """Build the face on a virtual clock. loudspeaker: None: one without skew and jitter.

        is_listening: a recogniser runs; else only phonemes that come with the sound move the mouth.
        rate_hz: ticks a second. performance: rendered motion, which then moves the mouth alone.
        """
        face = assemble_face(FACE, None)
        self.loudspeaker = loudspeaker or SimulatedLoudspeaker()
        self.playout = Playout(self.loudspeaker)
        self._bus, self.clock = simulated_wire(face.settings)
        self._neutral_mm = face.model.markers_mm(face.model.rest[None])[0]
        self._names = [joint.name for joint in face.joints]
        recognizer: LiveRecognizer = make_recognizer() if is_listening else Deaf()
        synthesizer = make_synthesizer(face.model, MotionOptions())
        if performance is not None:
            recognizer = no_recognizer()
            synthesizer = StillMotion(face.model.rest)
        self.street = make_street(face, self.playout, self._bus, rate_hz, recognizer, synthesizer)

    def run(self, until_s: float, act: Callable[[float], None] | None = None) -> Watched:
        """Run from the first torque until `until_s` seconds after the sound's timeline began.

        act: called in each tick with the seconds since that beginning.
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
        all_encoders_deg = np.array(encoders_deg)
        return Watched(np.array(times_s), all_encoders_deg, self._gap_mm(all_encoders_deg), zero_s)

    def _gap_mm(self, positions_deg: Array) -> Array:
        """Return the lip gap, (n,) mm, by the face's geometry, of positions (n, n_servos)."""
        face = simulated_face(self._neutral_mm, self._names)
        markers_mm = marker_positions_mm(face, positions_deg)
        upper, lower = markers_mm[:, MARKERS_47.upper_lip], markers_mm[:, MARKERS_47.lower_lip]
        return np.asarray(upper[:, 1] - lower[:, 1])


def spoken_stream(
    text: SynthesizedSpeech, playout: Playout, *, knows: bool, kind: UnitKind | None = None
) -> PlayoutStream:
    """Return a whole synthesised text as a stream that has ended.

    knows: the stream carries the text's phonemes. kind: of the units that are sent before the
    sound, as a voice agent does; None: no units.
    """
    known = text.phonemes if knows else ()
    stream = PlayoutStream("text", text.sample_rate_hz, playout.output_rate_hz, known)
    if kind is not None:
        spoken_text = _as_units(text, kind)
        stream.tell(spoken_text, () if spoken_text.moves_mouth else pronounced_units(spoken_text))
    stream.push(text.samples)
    stream.end()
    return stream


def _as_units(text: SynthesizedSpeech, kind: UnitKind) -> SpokenText:
    """Return a synthesised text as units of one kind: all of it, its words, or its phonemes.

    Words and phonemes carry the sample at which each begins; the text carries none.
    """
    rate_hz = text.sample_rate_hz
    if kind == "text":
        joined = " ".join(word.text for word in text.words)
        return SpokenText(kind, (SpokenUnit(joined),), rate_hz)
    if kind == "word":
        units = [SpokenUnit(word.text, round(word.start_s * rate_hz)) for word in text.words]
    else:
        units = [SpokenUnit(e.phoneme, round(e.start_s * rate_hz)) for e in text.phonemes]
    return SpokenText(kind, tuple(units), rate_hz)
