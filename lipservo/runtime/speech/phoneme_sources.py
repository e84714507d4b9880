"""Phonemes and prosody of the sound that a face listens to or speaks."""

import math
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from typing import Final

from lipservo.runtime.speech.timed_units import FollowedUnits, MoverNews
from lipsync.arrays import Array
from lipsync.audio.playout import Playout
from lipsync.audio.playout_stream import KnownStretch, MoverReason, StartedWords
from lipsync.audio.source import AudioSource
from lipsync.audio_block import BLOCK_S, AudioBlock
from lipsync.phonemes import (
    Hearing,
    Listener,
    LiveRecognizer,
    PhonemeEvent,
    PhonemeUpdate,
    ServoListener,
)
from lipsync.prosody.voice_frame import SILENT_VOICE, VoiceFrame
from lipsync.prosody.voice_tracker import VoiceTracker
from lipsync.recognition.network_recognizer import FOLLOWING_LATENCY_S
from lipsync.recognition.streaming import RecognizerStream, SoundAhead
from lipsync.recognition.text_decoder import MovedBy, TextError, TextFollower
from lipsync.spoken_text import UnitKind
from lipsync.timeline import PhonemeTimeline

#: Voice frames of ten seconds: more than any delay from sound to face.
_N_KEPT: Final = 1_000


class HeardVoice:
    """A store of the voice frames (prosody, 10 ms each) of the last ten seconds of sound."""

    def __init__(self, listener: VoiceTracker) -> None:
        self._listener = listener
        # A ring: the frame of block n at index n modulo the length, with n to tell an older one.
        self._numbered_frames: list[tuple[int, VoiceFrame]] = [(-1, SILENT_VOICE)] * _N_KEPT

    def hear(self, block: AudioBlock) -> None:
        """Analyse the next 10 ms of sound and keep the resulting voice frame."""
        number = round(block.start_s / BLOCK_S)
        self._numbered_frames[number % _N_KEPT] = (number, self._listener.feed(block.samples))

    def at(self, sound_s: float) -> VoiceFrame:
        """Return the voice frame around sound time `sound_s` (10 ms); silence if none is kept."""
        number = math.floor(sound_s / BLOCK_S + 1e-6)
        stored_number, frame = self._numbered_frames[number % _N_KEPT]
        return frame if stored_number == number else SILENT_VOICE

    def peaks(self, after_s: float, until_s: float, most: int) -> list[float]:
        """Return the peak (0 to 1) of each 10 ms between two sound times.

        after_s, until_s: the sound times. Of more than `most` peaks the last are returned.
        """
        first, last = (math.floor(time_s / BLOCK_S + 1e-6) for time_s in (after_s, until_s))
        return [self.at(n * BLOCK_S).peak for n in range(max(first, last - most) + 1, last + 1)]


class _FedRecognizer:
    """A recogniser that is fed sound, and what it reports of it."""

    def __init__(self, recognizer: LiveRecognizer, voice: HeardVoice | None) -> None:
        """Keep a recogniser, and the analysis of the same sound's voice, if given."""
        self._voice = voice
        self._recognizer = recognizer
        self._listener = recognizer if isinstance(recognizer, Listener) else None
        self._follower = recognizer if isinstance(recognizer, TextFollower) else None
        self._recognition = RecognizerStream(recognizer)

    @property
    def latency_s(self) -> float:
        """The recogniser's latency: at sound time t phonemes before t - latency_s are final."""
        return self._recognizer.latency_s

    @property
    def hearing(self) -> Hearing | None:
        """The recogniser's class of the sound (speech, noise, ...); None: it reports none."""
        return None if self._listener is None else self._listener.hearing

    @property
    def moved_by(self) -> MovedBy | None:
        """Whether a text or the sound moves the mouth; None if the recogniser follows no text."""
        return None if self._follower is None else self._follower.moved_by

    @property
    def saying(self) -> tuple[tuple[str, ...], int]:
        """The words around the one spoken now, and its index in them; ((), 0): no text is known."""
        return ((), 0) if self._follower is None else self._follower.saying


class RecognizedPhonemes(_FedRecognizer):
    """A `PhonemeSource` that feeds the sound of a source to a recogniser."""

    def __init__(
        self, source: AudioSource, recognizer: LiveRecognizer, voice: HeardVoice | None = None
    ) -> None:
        """Connect a source to a recogniser. voice: analyses its sound as well, if given."""
        super().__init__(recognizer, voice)
        self._source = source
        self._sound = SoundAhead(source, recognizer)
        #: The sound time until which sound was recognised, in s.
        self.heard_until_s = 0.0

    def note_servo_speeds(self, sound_s: float, speeds_deg_s: Array) -> None:
        """Pass servo speeds to the recogniser if the source is live: servo noise is in its sound.

        Parameters
        ----------
        sound_s : float
            Sound time of the speeds, s.
        speeds_deg_s : Array
            (n_servos,) degrees a second.
        """
        if self._source.is_live and isinstance(self._recognizer, ServoListener):
            self._recognizer.note_servo_speeds(sound_s, speeds_deg_s)

    def updates(self, until_s: float) -> list[PhonemeUpdate]:
        """Recognise the sound due at sound time `until_s`; return the phoneme updates from it."""
        # A device gives what has arrived, whatever the clock says.
        blocks = self._sound.blocks(math.inf if self._source.is_live else until_s)
        if self._voice is not None:
            for block in blocks:
                self._voice.hear(block)
        step = self._recognition.feed(blocks)
        if blocks:
            self.heard_until_s = blocks[-1].end_s
        return list(step.updates)


#: Phonemes known beforehand are passed on so far ahead of the sound: more than the longest
#: look-ahead that moves a mouth, less than a sentence in every update.
_AHEAD_S = 1.0


class SpokenPhonemes(_FedRecognizer):
    """A `PhonemeSource` of a playout: phonemes are recognised, or known with the streams."""

    def __init__(
        self, playout: Playout, recognizer: LiveRecognizer, voice: HeardVoice | None = None
    ) -> None:
        """Connect a playout to a recogniser. voice: analyses all spoken sound as well, if given."""
        super().__init__(recognizer, voice)
        self._playout = playout
        self._followed_kind: UnitKind = "text"
        self._awaits_words = False  # words were told, and not all of them were followed so far
        self._sent_units, self._mover_news = FollowedUnits(playout), MoverNews(playout)
        # All recognised phonemes: while units came with times, they become final later than the
        # recogniser says, and those in between must be passed on again.
        self._recognised = PhonemeTimeline()
        self._final_s = 0.0

    @property
    def heard_until_s(self) -> float:
        """The sound time, s, until which the playout's sound is committed (fixed, recognised)."""
        return self._playout.committed_s

    @property
    def moved_by(self) -> MovedBy | None:
        """The source of the motion: sound, text, words, phonemes or visemes; None: not known.

        Of the sound that has just become final. Phonemes and visemes come with the stream; text and
        words are followed by the recogniser, in the units that the client sent.
        """
        now_s = self._playout.committed_s - self.latency_s
        if self._playout.knows_phonemes(now_s):
            return "phonemes"
        if (units := self._sent_units.kind_at(now_s)) is not None:
            return units
        moved_by = super().moved_by
        return _MOVER_OF_KIND[self._followed_kind] if moved_by == "text" else moved_by

    @property
    def units_shifted_s(self) -> float | None:
        """How much later than sent timed units are heard, s; None where none move the mouth."""
        return self._sent_units.shifted_s

    @property
    def saying(self) -> tuple[tuple[str, ...], int]:
        """The words around the one spoken now, and its index in them; ((), 0): no text is known.

        Found by the words' times where they have some, else by the recogniser that follows them.
        """
        return self._playout.timed_words() or super().saying

    def note_servo_speeds(self, _sound_s: float, speeds_deg_s: Array) -> None:
        """Pass servo speeds to a recogniser that listens to the microphone, which has servo noise.

        What the microphone captures now lies ahead of what is heard now, on the same timeline.

        Parameters
        ----------
        _sound_s : float
            Sound time of what is heard now, s.
        speeds_deg_s : Array
            (n_servos,) degrees a second.
        """
        captured_s = self._playout.microphone_s
        if captured_s is not None and isinstance(self._recognizer, ServoListener):
            self._recognizer.note_servo_speeds(captured_s, speeds_deg_s)

    def updates(self, until_s: float) -> list[PhonemeUpdate]:
        """Commit and recognise the sound due at sound time `until_s`; return its phoneme updates.

        Committed sound is written to the loudspeaker, to be heard later.
        """
        # Pairs: sound for the recogniser, silent where phonemes are known, and sound as spoken.
        blocks = self._playout.commit(until_s)
        for words in self._playout.take_words():
            if self._follower is not None:
                self._follow_words(self._follower, words)
        if self._voice is not None:
            for _, spoken in blocks:
                self._voice.hear(spoken)
        self._sent_units.add_committed()
        step = self._recognition.feed([heard for heard, _ in blocks])
        updates = [self._with_sent_units(update) for update in step.updates]
        if (shifted := self._sent_units.newly_shifted()) is not None:
            self._mover_news.report_shift(*shifted)
        known, present = super().saying
        if known:
            self._awaits_words = present < len(known)
        unknown: MoverReason = "not_followed" if self._awaits_words else "not_told"
        self._mover_news.report_mover(
            self.moved_by,
            is_speech=self.hearing == "speech",
            why_sound="not_said" if known else unknown,
            are_spoken=self._sent_units.is_believed,
        )
        return updates

    def _with_sent_units(self, update: PhonemeUpdate) -> PhonemeUpdate:
        """Return a recogniser's update in which known phonemes replace the recognised ones.

        Known are the phonemes that synthesised speech has, and units that clients sent with times,
        these only where they agree with the sound. While there are such units, phonemes become
        final later, so that the sound can still move them.
        """
        self._recognised.apply(update)
        if update.evidence is not None:
            self._sent_units.hear(update.evidence)
        final_s = update.final_until_s
        if not self._sent_units.is_empty and update.evidence is not None:
            final_s = max(self._final_s, min(final_s, update.heard_until_s - FOLLOWING_LATENCY_S))
        # The update then has to reach back to what was final last, not only to what is new.
        if self._final_s < update.replace_from_s:
            heard = _clipped(self._recognised.events, self._final_s, math.inf)
            update = replace(update, replace_from_s=self._final_s, events=tuple(heard))
        update, self._final_s = replace(update, final_until_s=final_s), final_s
        stretches = (
            *self._playout.known_phonemes(update.replace_from_s),
            *self._sent_units.stretches(update.replace_from_s, update.heard_until_s + _AHEAD_S),
        )
        return with_known(update, sorted(stretches, key=lambda stretch: stretch[0]))

    def _follow_words(self, follower: TextFollower, words: StartedWords) -> None:
        """Give the recogniser the words that come next, instead of earlier ones if they are new."""
        if words.is_new:
            follower.forget()
        self._awaits_words = bool(words.words) or (self._awaits_words and not words.is_new)
        self._followed_kind = words.kind
        with suppress(TextError):  # too many words wait: these are recognised like any others
            follower.tell(words.words, words.behind_s)


#: What moves the mouth, by the kind of the units that the recogniser follows in the sound.
_MOVER_OF_KIND: Final[dict[UnitKind, MovedBy]] = {
    "text": "text",
    "word": "words",
    "phoneme": "phonemes",
    "viseme": "visemes",
}


def with_known(update: PhonemeUpdate, stretches: Iterable[KnownStretch]) -> PhonemeUpdate:
    """Return the update; within `stretches` known phonemes replace the recognised ones.

    stretches: (start_s, end_s, events) in order of time, not overlapping.
    """
    events, posteriors = list(update.events), update.posteriors
    for start_s, end_s, known_events in stretches:
        posteriors = None  # known phonemes are certain
        known_until_s = min(end_s, update.heard_until_s + _AHEAD_S)
        overlapping = [event for event in known_events if event.start_s < known_until_s]
        overlapping = [event for event in overlapping if _end_s(event) > update.replace_from_s]
        # Speech may be cut off within a phoneme, and continue within one.
        known_part = _clipped(overlapping, start_s, end_s)
        # While the rest of a stretch is not passed on yet, nor is anything behind it: the two would
        # overlap later.
        after = _clipped(events, end_s, math.inf) if known_until_s == end_s else []
        events = [*_clipped(events, -math.inf, start_s), *known_part, *after]
    return replace(update, events=tuple(events), posteriors=posteriors)


def _clipped(events: Iterable[PhonemeEvent], from_s: float, until_s: float) -> list[PhonemeEvent]:
    """Return the events, or parts of events, that lie between two times, in s."""
    found = []
    for event in events:
        start_s, end_s = max(event.start_s, from_s), min(_end_s(event), until_s)
        if end_s > start_s:
            found.append(
                replace(event, start_s=start_s, end_s=None if end_s == math.inf else end_s)
            )
    return found


def _end_s(event: PhonemeEvent) -> float:
    return math.inf if event.end_s is None else event.end_s
