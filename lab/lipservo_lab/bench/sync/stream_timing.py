"""A voice agent's stream: how soon it is seen and heard, how fast it stops, what jitter does."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from lipservo_lab.bench.sync.speaking_robot import SimulatedLoudspeaker, SpeakingRobot, Watched
from lipservo_lab.bench.sync.speech_timing import first_sample_s
from lipsync.audio.playout_stream import PlayoutRequest, PlayoutStream
from lipsync.markers import CLOSED_GAP_MM
from lipsync.text_to_speech.synthesis import SynthesizedSpeech

#: The face is at full strength and at rest by then.
_READY_S: Final = 2.0
_TAIL_S: Final = 2.0
#: Agents send pieces of this length.
_CHUNK_S: Final = 0.020
#: Four encoder pulses: more than the servos' own trembling.
_MOVED_DEG: Final = 0.35
#: Of full scale: quieter samples are no speech.
_SOUNDS: Final = 0.002
#: Lips open wider than this share of their range, so long after the last speech, are stuck.
_STUCK_SHARE, _STUCK_AFTER_S = 0.25, 0.400
#: A mouth opens so long before the sound of a vowel: that is no mouth that is stuck.
_OPENING_S: Final = 0.100


@dataclass(frozen=True, slots=True)
class FirstSeen:
    """Delays from a stream's first byte to the first motion, and to the first sound, seconds."""

    motion_s: float
    sound_s: float


@dataclass(frozen=True, slots=True)
class BargeIn:
    """closed_s: from an interruption to closed lips; played_error_s: error of the played sound.

    The latter: the seconds that the face reports as played, less those that were.
    """

    closed_s: float
    played_error_s: float


def first_seen(text: SynthesizedSpeech) -> FirstSeen:
    """Play a stream whose first byte is speech, at the pace of speech; return when it is seen."""
    voiced = _without_lead_in(text)
    robot = SpeakingRobot(is_listening=True)
    feed = _Feed(robot, voiced, text.sample_rate_hz, _even(len(voiced), text.sample_rate_hz))
    watched = robot.run(_READY_S + 1.0, feed.advance)
    samples, played_s = robot.loudspeaker.played()
    first_byte_s = watched.zero_s + _READY_S
    rest_deg = watched.encoders_deg[np.searchsorted(watched.times_s, first_byte_s) - 1]
    is_moving = (np.abs(watched.encoders_deg - rest_deg) > _MOVED_DEG).any(axis=1)
    is_moving &= watched.times_s >= first_byte_s
    sound_s = float(played_s[np.flatnonzero(np.abs(samples) > _SOUNDS)[0]])
    return FirstSeen(float(watched.times_s[is_moving][0]) - first_byte_s, sound_s - first_byte_s)


def barge_in(text: SynthesizedSpeech, after_s: float, rate_hz: float) -> BargeIn:
    """Interrupt a robot `after_s` after its first sound was played; return how soon lips close.

    `after_s` is to be chosen such that the lips are open then. rate_hz: of the servo loop.
    """
    robot = SpeakingRobot(is_listening=True, rate_hz=rate_hz)
    samples = text.samples
    feed = _Feed(robot, samples, text.sample_rate_hz, _even(len(samples), text.sample_rate_hz))
    requested_s: list[float] = []
    interrupt_at_s = _READY_S + robot.street.speech.delay.total_s + after_s

    def feed_and_interrupt(now_s: float) -> None:
        feed.advance(now_s)
        if now_s >= interrupt_at_s and not requested_s:
            requested_s.append(now_s)
            robot.playout.requests.append(PlayoutRequest("interrupt"))

    watched = robot.run(interrupt_at_s + 1.0, feed_and_interrupt)
    interrupted_s = watched.zero_s + requested_s[0]
    is_after = watched.times_s >= interrupted_s
    closed_s = watched.times_s[is_after & (watched.gap_mm <= CLOSED_GAP_MM)][0] - interrupted_s
    (event,) = (each for each in robot.playout.events if each.kind == "interrupted")
    played, left_s = robot.loudspeaker.played()
    last_sounding = int(np.flatnonzero(np.abs(played) > 0.0)[-1])
    began_s = first_sample_s(text, robot.loudspeaker)
    heard_s = float(left_s[last_sounding]) - began_s
    return BargeIn(float(closed_s), abs(event.n_played / text.sample_rate_hz - heard_s))


def stuck_open_s(
    texts: Sequence[SynthesizedSpeech], rng: np.random.Generator
) -> tuple[float, float, int]:
    """Play texts as streams with jitter; return seconds of open lips in pauses, and underruns.

    First: seconds in which lips stay open without sound to say; second: seconds in which they open
    for the sound that follows, which is no fault; third: number of underruns.
    """
    stuck_s, opening_s, n_underruns = 0.0, 0.0, 0
    for text in texts:
        robot = SpeakingRobot(is_listening=True)
        schedule = _jittery(len(text.samples), text.sample_rate_hz, rng)
        feed = _Feed(robot, text.samples, text.sample_rate_hz, schedule)
        watched = robot.run(_READY_S + schedule[-1][0] + _TAIL_S, feed.advance)
        text_stuck_s, text_opening_s = _open_times_s(watched, robot.loudspeaker)
        stuck_s += text_stuck_s
        opening_s += text_opening_s
        n_underruns += robot.playout.n_underruns
    return stuck_s, opening_s, n_underruns


def _open_times_s(watched: Watched, loudspeaker: SimulatedLoudspeaker) -> tuple[float, float]:
    """Return seconds of lips that are stuck open, and of lips that open for the next sound."""
    samples, left_s = loudspeaker.played()
    speech_s = left_s[np.abs(samples) > _SOUNDS]
    next_speech = np.searchsorted(speech_s, watched.times_s)
    since_s = watched.times_s - np.concatenate(([-np.inf], speech_s))[next_speech]
    until_s = np.concatenate((speech_s, [np.inf]))[next_speech] - watched.times_s
    rest_mm = float(np.median(watched.gap_mm[:20]))
    open_mm = rest_mm + _STUCK_SHARE * (float(watched.gap_mm.max()) - rest_mm)
    is_open = (watched.gap_mm > open_mm) & (since_s > _STUCK_AFTER_S)
    is_stuck, is_opening = is_open & (until_s > _OPENING_S), is_open & (until_s <= _OPENING_S)
    ticks_s = np.diff(watched.times_s)
    return float(ticks_s[is_stuck[1:]].sum()), float(ticks_s[is_opening[1:]].sum())


class _Feed:
    """Sends a sound to a robot as an agent's stream, chunk by chunk.

    schedule: (seconds since the stream began, number of samples sent by then).
    """

    def __init__(
        self,
        robot: SpeakingRobot,
        samples: NDArray[np.float32],
        rate_hz: int,
        schedule: Sequence[tuple[float, int]],
    ) -> None:
        self._samples = samples
        self._schedule = iter(schedule)
        self._next = next(self._schedule, None)
        self._n_sent = 0
        self._stream = PlayoutStream("agent", rate_hz, robot.playout.output_rate_hz)
        self._playout = robot.playout
        self._has_begun = False

    def advance(self, now_s: float) -> None:
        """Send the chunks that are due `now_s` seconds after the sound's timeline began."""
        if now_s < _READY_S:
            return
        if not self._has_begun:
            self._has_begun = True
            self._playout.requests.append(PlayoutRequest("say", self._stream))
        while self._next is not None and self._next[0] <= now_s - _READY_S:
            n_until = self._next[1]
            self._stream.push(self._samples[self._n_sent : n_until])
            self._n_sent = n_until
            self._next = next(self._schedule, None)
            if self._next is None:
                self._stream.end()


def _even(n_samples: int, rate_hz: int) -> list[tuple[float, int]]:
    """Return a schedule of chunks at the pace of speech, the first at once."""
    return [(n * _CHUNK_S, end) for n, end in enumerate(_chunk_ends(n_samples, rate_hz))]


def _chunk_ends(n_samples: int, rate_hz: int) -> Iterator[int]:
    length = round(_CHUNK_S * rate_hz)
    for end in range(length, n_samples + length, length):
        yield min(end, n_samples)


def _jittery(n_samples: int, rate_hz: int, rng: np.random.Generator) -> list[tuple[float, int]]:
    """Return a schedule in bursts: one chunk in twenty is 100 to 400 ms late, the rest wait."""
    sent_s, schedule = 0.0, []
    for n, end in enumerate(_chunk_ends(n_samples, rate_hz)):
        late_s = float(rng.uniform(0.1, 0.4)) if rng.random() < 0.05 else 0.0
        sent_s = max(sent_s, n * _CHUNK_S + late_s)
        schedule.append((sent_s, end))
    return schedule


def _without_lead_in(text: SynthesizedSpeech) -> NDArray[np.float32]:
    return text.samples[int(np.flatnonzero(np.abs(text.samples) > _SOUNDS)[0]) :]
