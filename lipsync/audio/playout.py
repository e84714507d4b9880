"""What the robot says, on one timeline: streams of speech one after the other, silence between.

The live loop requests blocks as sound time passes; a block is *committed* then: the recogniser gets
it at once, and the loudspeaker plays it later, by the declared delay that recogniser and servos
need until its face is shown. So the loudspeaker always holds that much sound, and lips and sound
agree. Where a stream has nothing ready, silence is committed, and the stream continues when more
has come.

Other threads only append to `requests` and remove from `events`; the live loop does all else.

A microphone is listened to while the robot is silent (half duplex): while the robot speaks its
mouth shows its own words, never those of the person it talks to, nor its own echo.
"""

from bisect import bisect_right
from collections import deque
from dataclasses import replace
from typing import Final
from weakref import WeakSet

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
    TimedUnits,
    add_playing,
    phonemes_or_visemes,
)
from lipsync.audio.source import BLOCK_SAMPLES, AudioSource, Loudspeaker
from lipsync.audio_block import BLOCK_S, AudioBlock, samples_before

Samples = NDArray[np.float32]

#: Requests that wait for the next tick; who receives streams refuses more.
_MOST_REQUESTS: Final = 64
#: Events that wait to be sent; beyond it the oldest are dropped.
_MOST_EVENTS: Final = 1024
#: Phonemes that wait to be sent; beyond it the oldest are dropped.
_MOST_PHONEMES: Final = 256
#: Groups of words and of units that wait for the recogniser; each tick takes them all.
_MOST_STARTED: Final = 256
#: Words that are shown before the one that is spoken, and from it on.
_WORDS_BEFORE, _WORDS_AFTER = 3, 11
#: Words that began longer ago than this are not searched for in the sound.
_OVER_S: Final = 1.0
#: A stream begins, and goes on after it ran dry, when so much of it waits: senders keep the pace of
#: speech in pieces of 20 to 40 ms, and a resampler holds 20 ms back.
_WAITING_S: Final = 0.05
#: A room echoes after a word; so long the microphone is not listened to.
_ECHO_S: Final = 0.3
_SILENCE: Final = np.zeros(BLOCK_SAMPLES, dtype=np.float32)
_SILENCE.flags.writeable = False
_NO_UNITS: Final = TimedUnits("", 0.0)
#: A microphone hands sound over in pieces of up to 40 ms (PulseAudio): so much is held back, or the
#: timeline, which goes on evenly, would find holes.
_HELD_BLOCKS: Final = 4
#: Beyond this the microphone's clock runs faster than ours; the oldest block is left out.
_MOST_BLOCKS: Final = 10
#: Blocks that may be on their way to the loudspeaker, to be taken back by a pause: ten seconds.
_MOST_ON_WAY: Final = 1000


class ListenedMicrophone:
    """A microphone whose sound is read in blocks of 10 ms, one per call, at the caller's pace."""

    def __init__(self, microphone: AudioSource) -> None:
        """Create the queue of blocks. microphone: live, already entered as a context manager."""
        self._microphone = microphone
        self._blocks: deque[Samples] = deque()
        self._n_dropped = 0
        self._is_primed = False

    @property
    def name(self) -> str:
        """The name of the microphone."""
        return self._microphone.name

    @property
    def lost_blocks(self) -> int:
        """The number of blocks that the device or the computer dropped, or that were left out."""
        return self._microphone.lost_blocks + self._n_dropped

    def take(self, n_more: int) -> Samples | None:
        """Remove and return the next 10 ms (160,) at 16 kHz; None while 40 ms are being gathered.

        They are gathered at the beginning, and again whenever the sound ran out. n_more: blocks
        that are taken right after it, as after a stall: so much sound is kept besides.
        """
        self._blocks.extend(each.samples for each in self._microphone.blocks(float("inf")))
        while len(self._blocks) > _MOST_BLOCKS + n_more:
            self._blocks.popleft()
            self._n_dropped += 1
        if not self._is_primed and len(self._blocks) < _HELD_BLOCKS:
            return None
        self._is_primed = bool(self._blocks)
        return self._blocks.popleft() if self._blocks else None

    def discard(self) -> None:
        """Discard all sound that the microphone has captured until now."""
        self._microphone.blocks(float("inf"))
        self._blocks.clear()
        self._is_primed = False


class Playout:
    """An endless `AudioSource`: streams of the robot's speech, else the microphone, or silence."""

    duration_s: float | None = None
    is_live = False

    def __init__(
        self,
        loudspeaker: Loudspeaker | None = None,
        microphone: ListenedMicrophone | None = None,
    ) -> None:
        """Create an empty timeline; `begin` starts it.

        loudspeaker: None where no sound is played, or the sender of a stream plays it. microphone:
        its sound goes to the recogniser while the robot is silent; it is not played.
        """
        self.loudspeaker = loudspeaker
        self._microphone = microphone
        self._listen_from_s = 0.0
        n_played = BLOCK_SAMPLES if loudspeaker is None else loudspeaker.rate_hz // 100
        self._played_silence: Samples = np.zeros(n_played, dtype=np.float32)
        #: What is to be done in the next `advance`; any thread appends.
        self.requests: deque[PlayoutRequest] = deque(maxlen=_MOST_REQUESTS)
        #: Senders that will request more; the playout is not over while any is in it. Any thread.
        self.announced: set[object] = set()
        #: (monotonic seconds, stream, samples of it that had left the loudspeaker by then), from
        #: who plays a stream elsewhere; any thread appends.
        self.reports: deque[tuple[float, str, int]] = deque(maxlen=_MOST_REQUESTS)
        #: Samples at 16 kHz of speech that could not be decoded; any thread appends.
        self.lost: deque[int] = deque()
        self._n_lost = 0
        #: What has happened; one other thread removes.
        self.events: deque[PlayoutEvent] = deque(maxlen=_MOST_EVENTS)
        self._playing: deque[PlayingStream] = deque()
        #: Blocks not heard yet: (start_s, stream, block, samples of the stream before it).
        self._not_heard: deque[tuple[float, PlayingStream, PlayoutBlock, int]] = deque(
            maxlen=_MOST_ON_WAY
        )
        self._is_paused = False
        #: Streams heard to their end; whoever still holds one may be making what follows it.
        self._heard_whole: WeakSet[PlayoutStream] = WeakSet()
        self._known_phonemes = KnownPhonemes()
        self._started_words: deque[StartedWords] = deque(maxlen=_MOST_STARTED)
        self._words_stream: PlayingStream | None = None
        self._timed_units: deque[TimedUnits] = deque(maxlen=_MOST_STARTED)
        self._last_units = _NO_UNITS
        self._n_blocks = 0
        self._n_underruns = 0
        #: (phoneme, start_s, end_s) on the timeline, each when it begins to be heard: as `events`.
        self.phonemes: deque[tuple[str, float, float]] = deque(maxlen=_MOST_PHONEMES)
        self._position_s = 0.0
        self._mute_until_s = 0.0
        #: Silence that was written before the timeline began.
        self.preroll_s = 0.0

    @property
    def name(self) -> str:
        """The name of the sound outside of speech: the microphone's, or "own voice" without one."""
        return "own voice" if self._microphone is None else self._microphone.name

    @property
    def lost_blocks(self) -> int:
        """The number of blocks that the microphone lost, or that were damaged in a file."""
        n_unheard = 0 if self._microphone is None else self._microphone.lost_blocks
        return n_unheard - (-self._n_lost // BLOCK_SAMPLES)

    @property
    def microphone_s(self) -> float | None:
        """The timeline position of what the microphone captures now; None while it is not heard.

        The device's own delay, of some 10 to 40 ms, is not known and not in it.
        """
        if self._microphone is None or not self._is_listening:
            return None
        return self.committed_s + _HELD_BLOCKS * BLOCK_S

    @property
    def _is_listening(self) -> bool:
        """Whether no stream is queued and the echo of the last one is over."""
        return not self._playing and self._position_s >= self._listen_from_s

    @property
    def output_rate_hz(self) -> int:
        """The sample rate in Hz of the loudspeaker, for which new streams must be made."""
        return 100 * len(self._played_silence)

    @property
    def latency_s(self) -> float:
        """Seconds from committing a block to its being heard, at the least; 0: no loudspeaker."""
        return 0.0 if self.loudspeaker is None else self.loudspeaker.latency_s + BLOCK_S

    @property
    def n_underruns(self) -> int:
        """The number of times that a stream or the loudspeaker had nothing to play in time."""
        return self._n_underruns + (self.loudspeaker.n_underruns if self.loudspeaker else 0)

    @property
    def committed_s(self) -> float:
        """The timeline position in seconds up to which blocks were handed out, and so are fixed."""
        return self._n_blocks * BLOCK_S

    @property
    def position_s(self) -> float:
        """The timeline position in s that leaves the loudspeaker, as of the last `advance`."""
        return self._position_s

    @property
    def is_over(self) -> bool:
        """Whether speech is over: no stream plays, waits, or is in `requests` or `announced`."""
        return not (self.announced or self.requests or self._playing)

    @property
    def is_idle(self) -> bool:
        """Whether nothing is spoken, nor heard, until a request comes: no microphone is open."""
        return self._microphone is None and self.is_over

    @property
    def speaking(self) -> str | None:
        """The name of the stream that plays, or else is next to play; None if none is queued."""
        return self._playing[0].stream.name if self._playing else None

    def n_played(self, stream: str) -> int | None:
        """Return how many samples of the stream of this name, at its own rate, were heard so far.

        None if no stream of this name plays or waits.
        """
        for playing in self._playing:
            if playing.stream.name == stream:
                return playing.n_played(self._position_s)
        return None

    def begin(self, lead_s: float, quiet_s: float = 0.0) -> None:
        """Begin the timeline now, so that a block is heard `lead_s` seconds after it is committed.

        The part of the lead that the loudspeaker does not hold back by itself is filled with
        silence. quiet_s: no speech is played before this position of the timeline, in s.
        """
        self._mute_until_s = quiet_s
        if self._microphone is not None:
            self._microphone.discard()  # what it captured while the face was being made
        if self.loudspeaker is None:
            return
        n_blocks = round((lead_s - self.loudspeaker.latency_s) / BLOCK_S)
        for _ in range(n_blocks):
            self.loudspeaker.write(self._played_silence)
        self.preroll_s = max(0, n_blocks) * BLOCK_S

    def be_quiet(self, for_s: float) -> None:
        """Play no speech for the next `for_s` seconds, then continue."""
        self._mute_until_s = max(self._mute_until_s, self.committed_s + for_s)

    def report(self) -> tuple[float, float] | None:
        """Return the newest report of what is heard: (monotonic seconds, timeline seconds then).

        The report comes from the sender that plays the current speech itself, else from the
        loudspeaker. None if the sender has reported nothing new, or the loudspeaker nothing so far,
        or there is no loudspeaker.
        """
        while self.reports:
            now_s, stream, n_samples = self.reports.popleft()
            for playing in self._playing:
                at_s = playing.timeline_s(n_samples)
                if playing.stream.name == stream and at_s is not None:
                    return now_s, at_s
        # One player at a time: reports of two would pull the clock to and fro.
        is_elsewhere = bool(self._playing) and self._playing[0].stream.played_elsewhere
        if self.loudspeaker is None or is_elsewhere:
            return None
        if (report := self.loudspeaker.position()) is None:
            return None
        return report[0], report[1] - self.preroll_s

    def stream_at(self, timeline_s: float) -> tuple[PlayoutStream, float] | None:
        """Return the stream at timeline position `timeline_s`, and the seconds since its start.

        None where no stream is played.
        """
        for playing in self._playing:
            for segment in playing.segments:
                if segment.start_s <= timeline_s < segment.end_s:
                    stream = playing.stream
                    before_s = segment.n_before / stream.sample_rate_hz
                    return stream, before_s + timeline_s - segment.start_s
        return None

    def advance(self, position_s: float) -> bool:
        """Carry out all `requests` and append the events that are due to `events`.

        position_s: the timeline position in s that leaves the loudspeaker now. Return whether
        speech was cut off, by an interruption or a pause.
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
                self._drop_uncommitted(request.name)
            elif request.kind == "pause":
                is_cut = self._pause() or is_cut
            elif request.kind == "resume" and self._is_paused:
                self._is_paused = False
                self._report_for_all("resumed")
        while self.lost:
            self._n_lost += self.lost.popleft()
        self._report_progress()
        self._known_phonemes.forget(self.committed_s)
        return is_cut

    def blocks(self, until_s: float) -> list[AudioBlock]:
        """Commit the timeline up to `until_s` in s; return the new blocks for the recogniser.

        Committed sound is written to the loudspeaker, to be heard later.
        """
        return [block for block, _ in self.commit(until_s)]

    def commit(self, until_s: float) -> list[tuple[AudioBlock, AudioBlock]]:
        """Commit the timeline up to `until_s` in s; return pairs of new blocks.

        Committed sound is written to the loudspeaker, to be heard later. The first block of a pair
        is for the recogniser, the second is the sound as it is spoken. They differ where phonemes
        are known: the recogniser gets silence there.
        """
        n_until = int(samples_before(max(0.0, until_s))) // BLOCK_SAMPLES
        pairs = []
        while self._n_blocks < n_until:
            start_s = self.committed_s
            self._n_blocks += 1
            heard, played, spoken = self._next_block(start_s, n_until - self._n_blocks)
            if self.loudspeaker is not None:
                self.loudspeaker.write(played)
            pairs.append((AudioBlock(heard, start_s), AudioBlock(spoken, start_s)))
        return pairs

    def known_phonemes(self, from_s: float) -> list[KnownStretch]:
        """Return stretches (start_s, end_s, phonemes) of known phonemes that end after `from_s`."""
        return self._known_phonemes.after(from_s)

    def take_words(self) -> list[StartedWords]:
        """Remove and return the words committed since the last call, in timeline seconds."""
        started = list(self._started_words)
        self._started_words.clear()
        return started

    def take_timed(self) -> list[TimedUnits]:
        """Remove and return, in order, the units of the sound committed since the last call."""
        timed = list(self._timed_units)
        self._timed_units.clear()
        return timed

    def timed_words(self) -> tuple[tuple[str, ...], int] | None:
        """Return the word heard now with 3 before and 10 after it at most, and its index in these.

        None where no stream is playing whose words have times.
        """
        playing = self._playing[0] if self._playing else None
        words = None if playing is None else playing.stream.spoken.get("word")
        if playing is None or words is None or not words.is_timed:
            return None
        n_played = playing.n_played(self._position_s)
        n_begun = bisect_right(words.units, n_played, key=lambda unit: unit.start_sample or 0)
        number = max(0, n_begun - 1)
        first = max(0, number - _WORDS_BEFORE)
        around = words.units[first : number + _WORDS_AFTER]
        return tuple(unit.label for unit in around), number - first

    def knows_phonemes(self, timeline_s: float) -> bool:
        """Return whether a stream is played at timeline position `timeline_s` with its phonemes."""
        found = self.stream_at(timeline_s)
        return found is not None and bool(found[0].phonemes)

    def __enter__(self) -> "Playout":
        return self

    def __exit__(self, *exc: object) -> None:
        """Do nothing: the loudspeaker is closed by the caller that opened it."""

    def _next_block(self, start_s: float, n_more: int) -> tuple[Samples, Samples, Samples]:
        """Return the next 10 ms, from `start_s` on, as three blocks; `n_more` follow at once.

        The blocks are for the recogniser, the loudspeaker and the prosody tracker. All are of the
        first stream that has sound, but the recogniser's is silent if the stream's phonemes are
        known, the loudspeaker's if another program plays the stream. Without a stream the
        loudspeaker's is silent, the other two are the microphone's, or silent.
        """
        candidates = (queued for queued in self._playing if not queued.stream.is_over)
        may_speak = start_s >= self._mute_until_s and not self._is_paused
        playing = next(candidates, None) if may_speak else None
        block = None if playing is None or not _is_ready(playing) else playing.stream.take()
        if playing is None or block is None:
            if playing is not None and playing.segments and not playing.is_starved:
                self._note_underrun(playing)
            self._queue_timed_units(TimedUnits("", start_s))
            from_microphone = self._microphone_block(start_s, n_more)
            return from_microphone, self._played_silence, from_microphone
        stream = playing.stream
        self._known_phonemes.note_playing(playing, start_s)
        playing.is_starved = False
        self._not_heard.append((start_s, playing, block, playing.n_taken))
        playing.add_block(start_s, block.n_samples)
        self._queue_words(playing, start_s)
        units = None if stream.phonemes else phonemes_or_visemes(stream)
        began_s = playing.segments[-1].start_s
        self._queue_timed_units(TimedUnits(stream.name, start_s, units, began_s, playing.shift_s))
        # Where phonemes are known, those that a recogniser finds could only be worse.
        heard = _SILENCE if stream.phonemes else block.heard
        played = self._played_silence if stream.played_elsewhere else block.played
        return heard, played, block.heard

    def _queue_words(self, playing: PlayingStream, start_s: float) -> None:
        """Queue the words that a stream's sender added since its last block, in timeline seconds.

        playing: the stream whose block begins at timeline position `start_s`.
        """
        if playing is not self._words_stream:
            self._cancel_words()
            self._words_stream = playing
        started_words = playing.stream.started_words
        while started_words:
            added = started_words.popleft()
            # A text that began earlier: in place of its start, how far its sound has passed.
            shift_s, behind_s, given_words = playing.shift_s, 0.0, added.words
            began_s = given_words[0].start_s if added.kind == "text" and given_words else None
            if began_s is not None and began_s + shift_s < start_s:
                behind_s = start_s - began_s - shift_s
                given_words = (replace(given_words[0], start_s=None), *given_words[1:])
            words = tuple(
                word if word.start_s is None else replace(word, start_s=word.start_s + shift_s)
                for word in given_words
                if word.start_s is None or word.start_s + shift_s > start_s - _OVER_S
            )
            playing.is_followed = True
            self._started_words.append(StartedWords(added.kind, words, added.is_new, behind_s))

    def _queue_timed_units(self, timed: TimedUnits) -> None:
        """Queue the units of the sound from `timed.from_s` on, if they differ from the last."""
        last = self._last_units
        if timed.units is not last.units or timed.start_s != last.start_s:
            self._last_units = timed
            self._timed_units.append(timed)

    def _cancel_words(self) -> None:
        """Queue a message that cancels the words of the last stream that were not spoken yet."""
        if self._words_stream is not None and self._words_stream.is_followed:
            self._started_words.append(StartedWords("text", (), is_new=True))
        self._words_stream = None

    def _microphone_block(self, start_s: float, n_more: int) -> Samples:
        """Return 10 ms (160,) of the microphone, for the recogniser, from `start_s` on; or silence.

        Silence without a microphone, while too little has come, while the robot speaks, and until
        the echo of its speech is over.
        """
        if self._microphone is None or not self._is_listening:
            # Known silence, not recognised: the mouth closes a tenth of a second sooner.
            self._known_phonemes.add_silence(start_s, start_s + BLOCK_S)
            if self._microphone is not None:
                self._microphone.discard()
            return _SILENCE
        self._known_phonemes.note_playing(None, start_s)
        samples = self._microphone.take(n_more)
        return _SILENCE if samples is None else samples

    def _note_underrun(self, playing: PlayingStream) -> None:
        """Mark a stream as starved; count an underrun unless its sender waits for a mark."""
        playing.is_starved = True
        if playing.stream.is_marked:  # its sender waits until this was heard
            return
        self._n_underruns += 1
        n_played = playing.n_played(self._position_s)
        name = playing.stream.name
        self.events.append(PlayoutEvent("underrun", name, self._position_s, n_played))

    def _interrupt(self) -> bool:
        """Drop all streams and silence the loudspeaker; return whether any stream was queued."""
        self._drop_what_follows()
        if not self._playing:
            return False
        cut_s = self._silence_loudspeaker()
        self._is_paused = False
        for playing in self._playing:
            playing.stream.drop()
            n_played = playing.n_played(cut_s)
            n_dropped = playing.stream.n_received - n_played
            event = PlayoutEvent("interrupted", playing.stream.name, cut_s, n_played, n_dropped)
            self.events.append(event)
        self._playing.clear()
        self._not_heard.clear()
        self._cancel_words()
        self._note_silence(cut_s)
        return True

    def _pause(self) -> bool:
        """Silence the loudspeaker and hold all streams; return False if there was none to hold.

        A block that has begun to be heard counts as heard, though up to 10 ms of it are cut off.
        """
        if not self._playing or self._is_paused:
            return False
        cut_s = self._silence_loudspeaker()
        while self._not_heard and self._not_heard[-1][0] >= cut_s:
            start_s, playing, block, n_before = self._not_heard.pop()
            playing.stream.put_back(block)
            playing.remove_block(start_s, n_before)
        self._is_paused = bool(self._playing)
        self._report_for_all("paused")
        self._note_silence(cut_s)
        return True

    def _silence_loudspeaker(self) -> float:
        """Silence the loudspeaker, append the events due; return where silence begins, in s."""
        if self.loudspeaker is not None:
            silent_s = self.loudspeaker.silence_rest() - self.preroll_s
            self._position_s = max(self._position_s, silent_s)
        self._report_progress()
        return self._position_s

    def _note_silence(self, cut_s: float) -> None:
        """Record that no speech is heard after timeline position `cut_s`; its echo lasts 0.3 s."""
        self._listen_from_s = cut_s + _ECHO_S
        self._known_phonemes.cut(cut_s)
        self._queue_timed_units(TimedUnits("", cut_s))
        if cut_s < self.committed_s:
            self._known_phonemes.add_silence(cut_s, self.committed_s)

    def _report_for_all(self, kind: EventKind) -> None:
        """Append an event of this kind for every stream that plays or waits."""
        for playing in self._playing:
            name, n_played = playing.stream.name, playing.n_played(self._position_s)
            self.events.append(PlayoutEvent(kind, name, self._position_s, n_played))

    def _drop_what_follows(self) -> None:
        """Drop speech of which a part was heard to its end, and the rest is still being made."""
        for stream in list(self._heard_whole):
            stream.drop()
        self._heard_whole.clear()

    def _drop_uncommitted(self, name: str) -> None:
        """Drop speech that is not committed yet; committed speech is still heard.

        name: of its streams; "": all speech, with what follows parts that were heard to their end.
        """
        if not name:
            self._drop_what_follows()
        for playing in self._playing:
            stream, at_s = playing.stream, self._position_s
            if stream.is_over or name not in ("", stream.name):
                continue
            stream.drop()
            n_played, n_dropped = playing.n_played(at_s), stream.n_received - playing.n_taken
            self.events.append(PlayoutEvent("cleared", stream.name, at_s, n_played, n_dropped))

    def _report_progress(self) -> None:
        """Append events for the starts, marks and ends of streams that the position has passed."""
        while self._not_heard and self._not_heard[0][0] < self._position_s:
            self._not_heard.popleft()
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
            self._heard_whole.add(playing.stream)
            self._playing.popleft()
            self._is_paused = self._is_paused and bool(self._playing)
            self._listen_from_s = position_s + _ECHO_S


def _is_ready(playing: PlayingStream) -> bool:
    """Return whether a stream can be played: it plays, has 50 ms waiting, or gets no more now."""
    stream = playing.stream
    is_going_on = bool(playing.segments) and not playing.is_starved
    return is_going_on or stream.ended or stream.is_filled or stream.waiting_s >= _WAITING_S
