"""What the robot says, on one timeline: streams of speech one after the other, silence between.

The live loop takes blocks as sound time passes. A block is *committed* then: the recogniser
gets it at once, the loudspeaker plays it a declared delay later. So the loudspeaker always holds
that delay in sound, and lips and sound meet. Where a stream has nothing ready, silence is
committed, and the stream goes on when more has come.

Other threads only append to `requests` and take from `events`; all is decided in the loop.

A microphone is listened to while the robot is silent (half duplex): while the robot speaks its
mouth shows its own words, never those of the person it talks to, nor its own echo.
"""

from bisect import bisect_right
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from lipsync.audio.playout_stream import (
    EventKind,
    KnownPhonemes,
    KnownStretch,
    PlayingStream,
    PlayoutBlock,
    PlayoutEvent,
    PlayoutRequest,
    PlayoutStream,
    StartedWords,
    add_playing,
    phonemes_or_visemes,
)
from lipsync.audio.source import BLOCK_SAMPLES, AudioSource, Loudspeaker
from lipsync.audio_block import BLOCK_S, AudioBlock, samples_before
from lipsync.spoken_text import PronouncedWord, SpokenUnit

Samples = NDArray[np.float32]

#: Requests that wait for the next tick; streams beyond it are refused by whoever receives them.
_MOST_REQUESTS: Final = 64
#: Events that wait to be told; the oldest are dropped beyond it.
_MOST_EVENTS: Final = 1024
#: Phonemes that wait to be told; nobody is told those of a minute ago.
_MOST_PHONEMES: Final = 256
#: Texts of streams that wait for who looks for them; each tick takes them all.
_MOST_STARTED: Final = 256
#: Words that are shown around the one that is said.
_WORDS_BEFORE, _WORDS_AFTER = 3, 11
#: Words that were said so long ago are not looked for any more.
_OVER_S: Final = 1.0
#: A stream begins, and goes on after it ran dry, when so much of it waits: senders keep the pace of
#: speech in pieces of 20 to 40 ms, and a resampler holds 20 ms back.
_WAITING_S: Final = 0.05
#: A room goes on sounding after a word; so long nobody is listened to.
_ECHO_S: Final = 0.3
_SILENCE: Final = np.zeros(BLOCK_SAMPLES, dtype=np.float32)
_SILENCE.flags.writeable = False
#: A microphone hands sound over in pieces of up to 40 ms (PulseAudio): so much is held back, or the
#: timeline, which goes on evenly, would find holes.
_HELD_BLOCKS: Final = 4
#: Beyond this the microphone's clock runs faster than ours; the oldest block is left out.
_MOST_BLOCKS: Final = 10
#: Blocks that may be on their way to the loudspeaker, to be taken back by a pause: ten seconds.
_MOST_ON_WAY: Final = 1000


class ListenedMicrophone:
    """The blocks of a microphone on another's timeline: one for each call."""

    def __init__(self, microphone: AudioSource) -> None:
        """microphone: entered, and live."""
        self._microphone = microphone
        self._blocks: deque[Samples] = deque(maxlen=_MOST_BLOCKS)
        self._is_primed = False

    @property
    def name(self) -> str:
        """The device's own name."""
        return self._microphone.name

    @property
    def lost_blocks(self) -> int:
        """Blocks that the device or the computer dropped."""
        return self._microphone.lost_blocks

    def take(self) -> Samples | None:
        """The next 10 ms (160,) at 16 kHz; None while too little has come."""
        for block in self._microphone.blocks(float("inf")):
            if len(block.samples) == BLOCK_SAMPLES:
                self._blocks.append(block.samples)
        if not self._is_primed and len(self._blocks) < _HELD_BLOCKS:
            return None
        self._is_primed = bool(self._blocks)
        return self._blocks.popleft() if self._blocks else None

    def discard(self) -> None:
        """Discard what was captured until now."""
        self._microphone.blocks(float("inf"))
        self._blocks.clear()
        self._is_primed = False


class Playout:
    """An `AudioSource` without end, of what the robot says; see the module."""

    duration_s: float | None = None
    is_live = False

    def __init__(
        self,
        loudspeaker: Loudspeaker | None = None,
        microphone: ListenedMicrophone | None = None,
    ) -> None:
        """loudspeaker: None where no sound is played, or the sender of the stream plays it.

        microphone: heard, not played, while the robot is silent.
        """
        self.loudspeaker = loudspeaker
        self._microphone = microphone
        self._quiet_from_s = 0.0
        n_played = BLOCK_SAMPLES if loudspeaker is None else loudspeaker.rate_hz // 100
        self._played_silence: Samples = np.zeros(n_played, dtype=np.float32)
        #: Any thread appends.
        self.requests: deque[PlayoutRequest] = deque(maxlen=_MOST_REQUESTS)
        #: Who will request more; until they are gone the playout is not over. For any thread.
        self.announced: set[object] = set()
        #: (monotonic seconds, stream, samples of it that had left the loudspeaker by then), from
        #: who plays a stream elsewhere; any thread appends.
        self.reports: deque[tuple[float, str, int]] = deque(maxlen=_MOST_REQUESTS)
        #: One other thread takes.
        self.events: deque[PlayoutEvent] = deque(maxlen=_MOST_EVENTS)
        self._playing: deque[PlayingStream] = deque()
        #: (start_s, stream, block, samples of the stream before it), of what is not heard yet.
        self._on_way: deque[tuple[float, PlayingStream, PlayoutBlock, int]] = deque(
            maxlen=_MOST_ON_WAY
        )
        self._is_paused = False
        self._known = KnownPhonemes()
        self._started_words: deque[StartedWords] = deque(maxlen=_MOST_STARTED)
        self._telling: PlayingStream | None = None
        self._n_blocks = 0
        self._n_underruns = 0
        #: (phoneme, start_s, end_s) on the timeline, each when it begins to be heard: as `events`.
        self.phonemes: deque[tuple[str, float, float]] = deque(maxlen=_MOST_PHONEMES)
        self._position_s = 0.0
        self._quiet_s = 0.0
        #: Silence that was written before the timeline began.
        self.preroll_s = 0.0

    @property
    def name(self) -> str:
        """The name of the sound that is heard while the robot is silent."""
        return "own voice" if self._microphone is None else self._microphone.name

    @property
    def lost_blocks(self) -> int:
        """Blocks that the microphone lost.

        Blocks of speech are never lost: they are played later.
        """
        return 0 if self._microphone is None else self._microphone.lost_blocks

    @property
    def output_rate_hz(self) -> int:
        """The rate that new streams are made for."""
        return 100 * len(self._played_silence)

    @property
    def latency_s(self) -> float:
        """How long after it was committed a block is heard at the earliest, one period included."""
        return 0.0 if self.loudspeaker is None else self.loudspeaker.latency_s + BLOCK_S

    @property
    def n_underruns(self) -> int:
        """How often there was nothing to play in time: of a stream, or in the loudspeaker."""
        return self._n_underruns + (self.loudspeaker.n_device_underruns if self.loudspeaker else 0)

    @property
    def committed_s(self) -> float:
        """The timeline is settled until then."""
        return self._n_blocks * BLOCK_S

    @property
    def position_s(self) -> float:
        """The timeline position that leaves the loudspeaker, in s, as of the last `advance`."""
        return self._position_s

    @property
    def is_over(self) -> bool:
        """Whether no sound is played or heard, and nothing waits or was announced."""
        return not (self.announced or self.requests or self._playing)

    @property
    def speaking(self) -> str | None:
        """The name of the stream that is being played."""
        return self._playing[0].stream.name if self._playing else None

    def n_played(self, stream: str) -> int | None:
        """Samples of a stream, at its own rate, that were heard so far; None: it does not play."""
        for playing in self._playing:
            if playing.stream.name == stream:
                return playing.n_played(self._position_s)
        return None

    def begin(self, lead_s: float, quiet_s: float = 0.0) -> None:
        """The timeline begins now, and is played `lead_s` after it was committed.

        What the loudspeaker does not hold back by itself is filled with silence. quiet_s: nothing
        Nothing is played for so long, in s.
        """
        self._quiet_s = quiet_s
        if self.loudspeaker is None:
            return
        n_blocks = round((lead_s - self.loudspeaker.latency_s) / BLOCK_S)
        for _ in range(n_blocks):
            self.loudspeaker.write(self._played_silence)
        self.preroll_s = max(0, n_blocks) * BLOCK_S

    def be_quiet(self, for_s: float) -> None:
        """Play nothing for `for_s` seconds, then go on."""
        self._quiet_s = max(self._quiet_s, self.committed_s + for_s)

    def report(self) -> tuple[float, float] | None:
        """(monotonic seconds, position on the timeline then), the newest that is known.

        Of the speech that plays now: by its sender, or by the loudspeaker. None: not known.
        """
        while self.reports:
            now_s, stream, n_samples = self.reports.popleft()
            for playing in self._playing:
                at_s = playing.timeline_s(n_samples)
                if playing.stream.name == stream and at_s is not None:
                    return now_s, at_s
        # Two who play would pull the clock to and fro.
        is_elsewhere = bool(self._playing) and self._playing[0].stream.played_elsewhere
        if self.loudspeaker is None or is_elsewhere:
            return None
        if (report := self.loudspeaker.position()) is None:
            return None
        return report[0], report[1] - self.preroll_s

    def stream_at(self, timeline_s: float) -> tuple[PlayoutStream, float] | None:
        """Return the stream that plays there, and seconds since its first sample; None: none."""
        for playing in self._playing:
            for segment in playing.segments:
                if segment.start_s <= timeline_s < segment.end_s:
                    stream = playing.stream
                    before_s = segment.n_before / stream.sample_rate_hz
                    return stream, before_s + timeline_s - segment.start_s
        return None

    def advance(self, position_s: float) -> bool:
        """Do what was requested, and tell what was heard; whether sound was cut off just now.

        position_s: on the timeline, what leaves the loudspeaker now.
        """
        self._position_s = max(self._position_s, position_s)
        is_cut = False
        while self.requests:
            request = self.requests.popleft()
            if request.kind == "say" and request.stream is not None:
                add_playing(self._playing, request.stream, request.after)
            elif request.kind == "interrupt":
                is_cut = self._interrupt() or is_cut
            elif request.kind == "clear":
                self._clear()
            elif request.kind == "pause":
                is_cut = self._pause() or is_cut
            elif request.kind == "resume":
                self._resume()
        self._tell()
        self._known.forget(self.committed_s)
        return is_cut

    def blocks(self, until_s: float) -> list[AudioBlock]:
        """Commit the timeline until then; the new blocks as the recogniser is to hear them."""
        return [block for block, _ in self.commit(until_s)]

    def commit(self, until_s: float) -> list[tuple[AudioBlock, AudioBlock]]:
        """Commit the timeline until then; each new block for the recogniser, and as it is spoken.

        The two differ where phonemes are known: the recogniser gets silence there.
        """
        return list(self._commit(int(samples_before(max(0.0, until_s))) // BLOCK_SAMPLES))

    def known_phonemes(self, from_s: float) -> list[KnownStretch]:
        """Stretches of the timeline that end after `from_s` and whose phonemes are known."""
        return self._known.after(from_s)

    def take_words(self) -> list[StartedWords]:
        """Return, once each, the words where the timeline is settled, in its seconds."""
        started = list(self._started_words)
        self._started_words.clear()
        return started

    def timed_words(self) -> tuple[tuple[str, ...], int] | None:
        """Words around the one that is heard now, and which of them it is, by their times.

        None where nothing is heard whose words have times.
        """
        playing = self._playing[0] if self._playing else None
        words = None if playing is None else playing.stream.spoken.get("word")
        if playing is None or words is None or not words.is_timed:
            return None
        n_played = playing.n_played(self._position_s)
        number = max(0, bisect_right(words.units, n_played, key=_start_sample) - 1)
        first = max(0, number - _WORDS_BEFORE)
        around = words.units[first : number + _WORDS_AFTER]
        return tuple(unit.label for unit in around), number - first

    def known_kind(self, timeline_s: float) -> Literal["phonemes", "visemes"] | None:
        """Return the kind of units known of the sound there; None: none, or nothing plays."""
        if not any(start_s <= timeline_s < end_s for start_s, end_s, _ in self._known.after(0.0)):
            return None
        if (found := self.stream_at(timeline_s)) is None:
            return None
        units = phonemes_or_visemes(found[0])
        return "visemes" if units is not None and units.kind == "viseme" else "phonemes"

    def __enter__(self) -> "Playout":
        return self

    def __exit__(self, *exc: object) -> None:
        """Release nothing: the loudspeaker is closed by its opener."""

    def _commit(self, n_until: int) -> Iterator[tuple[AudioBlock, AudioBlock]]:
        while self._n_blocks < n_until:
            start_s = self.committed_s
            self._n_blocks += 1
            heard, played, spoken = self._next(start_s)
            if self.loudspeaker is not None:
                self.loudspeaker.write(played)
            yield AudioBlock(heard, start_s), AudioBlock(spoken, start_s)

    def _next(self, start_s: float) -> tuple[Samples, Samples, Samples]:
        """The next 10 ms for the recogniser, for the loudspeaker, and for the prosody tracker."""
        waiting = (each for each in self._playing if not each.stream.is_over)
        may_speak = start_s >= self._quiet_s and not self._is_paused
        playing = next(waiting, None) if may_speak else None
        block = None if playing is None or not _is_ready(playing) else playing.stream.take()
        if playing is None or block is None:
            if playing is not None and playing.segments and not playing.is_starved:
                self._note_underrun(playing)
            listened = self._listened(start_s)
            return listened, self._played_silence, listened
        stream = playing.stream
        self._known.sounds(playing, start_s)
        playing.is_starved = False
        self._on_way.append((start_s, playing, block, playing.n_taken))
        playing.add(start_s, block.n_samples)
        self._tell_words(playing, start_s)
        # A recogniser that hears what is known anyway would only disagree.
        heard = _SILENCE if stream.phonemes else block.heard
        played = self._played_silence if stream.played_elsewhere else block.played
        return heard, played, block.heard

    def _tell_words(self, playing: PlayingStream, start_s: float) -> None:
        """Pass on the words that came since the last block for the stream at `start_s`."""
        is_other = playing is not self._telling
        if is_other:
            self._forget_words()
            self._telling = playing
        started_words = playing.stream.started_words
        while started_words:
            passed = started_words.popleft()
            shift_s, behind_s, given = playing.shift_s, 0.0, passed.words
            began_s = given[0].start_s if passed.kind == "text" and given else None
            if began_s is not None and began_s + shift_s < start_s:
                behind_s, given = start_s - began_s - shift_s, (_untimed(given[0]), *given[1:])
            words = tuple(
                each if each.start_s is None else replace(each, start_s=each.start_s + shift_s)
                for each in given
                if each.start_s is None or each.start_s + shift_s > start_s - _OVER_S
            )
            playing.is_followed = True
            self._started_words.append(StartedWords(passed.kind, words, passed.is_new, behind_s))

    def _forget_words(self) -> None:
        """Drop the words of the last stream that were not spoken."""
        if self._telling is not None and self._telling.is_followed:
            self._started_words.append(StartedWords("text", (), is_new=True))
        self._telling = None

    def _listened(self, start_s: float) -> Samples:
        """10 ms of the microphone; silence while the robot speaks, and until its echo is over."""
        is_speaking = bool(self._playing) or self._position_s < self._quiet_from_s
        if self._microphone is None or is_speaking:
            # Nobody need hear that it is silent: the mouth closes a tenth of a second sooner.
            self._known.is_silent(start_s, start_s + BLOCK_S)
            if self._microphone is not None:
                self._microphone.discard()
            return _SILENCE
        self._known.sounds(None, start_s)
        samples = self._microphone.take()
        return _SILENCE if samples is None else samples

    def _note_underrun(self, playing: PlayingStream) -> None:
        playing.is_starved = True
        if playing.stream.is_marked:  # its sender waits until this was heard
            return
        self._n_underruns += 1
        n_played = playing.n_played(self._position_s)
        name = playing.stream.name
        self.events.append(PlayoutEvent("underrun", name, self._position_s, n_played))

    def _interrupt(self) -> bool:
        """End all streams; return whether any was playing."""
        if not self._playing:
            return False
        cut_s = self._silenced()
        self._is_paused = False
        for playing in self._playing:
            playing.stream.drop()
            n_played = playing.n_played(cut_s)
            n_dropped = playing.stream.n_received - n_played
            event = PlayoutEvent("interrupted", playing.stream.name, cut_s, n_played, n_dropped)
            self.events.append(event)
        self._playing.clear()
        self._on_way.clear()
        self._forget_words()
        self._note_silence(cut_s)
        return True

    def _pause(self) -> bool:
        """Hold all streams; return whether any was playing.

        A block that has begun to be heard counts as heard: up to 10 ms of it never are.
        """
        if not self._playing or self._is_paused:
            return False
        cut_s = self._silenced()
        while self._on_way and self._on_way[-1][0] >= cut_s:
            start_s, playing, block, n_before = self._on_way.pop()
            playing.stream.put_back(block)
            playing.take_back(start_s, n_before)
        self._is_paused = bool(self._playing)
        self._tell_all("paused")
        self._note_silence(cut_s)
        return True

    def _resume(self) -> None:
        if self._is_paused:
            self._is_paused = False
            self._tell_all("resumed")

    def _silenced(self) -> float:
        """Where on the timeline the loudspeaker falls silent; events until then are reported."""
        if self.loudspeaker is not None:
            silent_s = self.loudspeaker.silence_rest() - self.preroll_s
            self._position_s = max(self._position_s, silent_s)
        self._tell()
        return self._position_s

    def _note_silence(self, cut_s: float) -> None:
        """Report that nothing committed after `cut_s` is heard."""
        self._quiet_from_s = cut_s + _ECHO_S
        self._known.cut(cut_s)
        if cut_s < self.committed_s:
            self._known.is_silent(cut_s, self.committed_s)

    def _tell_all(self, kind: EventKind) -> None:
        for playing in self._playing:
            name, n_played = playing.stream.name, playing.n_played(self._position_s)
            self.events.append(PlayoutEvent(kind, name, self._position_s, n_played))

    def _clear(self) -> None:
        """Drop all that is not committed; what is committed is still heard."""
        for playing in self._playing:
            if playing.stream.is_over:
                continue
            playing.stream.drop()
            n_played = playing.n_played(self._position_s)
            n_dropped = playing.stream.n_received - playing.n_taken
            name = playing.stream.name
            self.events.append(PlayoutEvent("cleared", name, self._position_s, n_played, n_dropped))

    def _tell(self) -> None:
        """Starts, marks and ends that the position has passed."""
        while self._on_way and self._on_way[0][0] < self._position_s:
            self._on_way.popleft()
        while self._playing:
            playing, position_s = self._playing[0], self._position_s
            name = playing.stream.name
            if not playing.has_begun:
                begins_s = playing.segments[0].start_s if playing.segments else None
                if begins_s is None and not playing.stream.is_over:
                    return
                if begins_s is not None and position_s < begins_s:
                    return
                playing.has_begun = True
                self.events.append(PlayoutEvent("started", name, position_s))
            n_played = playing.n_played(position_s)
            for mark in playing.stream.marks_until(n_played):
                self.events.append(PlayoutEvent("mark", name, position_s, n_played, name=mark))
            if not playing.is_heard(position_s):
                return
            self.events.append(PlayoutEvent("finished", name, position_s, n_played))
            self._playing.popleft()
            self._is_paused = self._is_paused and bool(self._playing)
            self._quiet_from_s = position_s + _ECHO_S


def _untimed(word: PronouncedWord) -> PronouncedWord:
    return replace(word, start_s=None)


def _start_sample(unit: SpokenUnit) -> int:
    return unit.start_sample or 0


def _is_ready(playing: PlayingStream) -> bool:
    """Whether a stream has enough sound to begin, or to go on."""
    stream = playing.stream
    is_going_on = bool(playing.segments) and not playing.is_starved
    return is_going_on or stream.ended or stream.is_filled or stream.waiting_s >= _WAITING_S
