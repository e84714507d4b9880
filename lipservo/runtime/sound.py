"""The sound that a face listens to, and the files and texts that it speaks itself."""

import logging
import threading
from collections import deque
from collections.abc import Generator, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from lipservo.runtime.run_request import (
    DEFAULT_MICROPHONE,
    DEFAULT_OUTPUT,
    SILENT_OUTPUT,
    RunRequest,
    Sound,
    VoiceOptions,
)
from lipservo.runtime.servos.assembly import load_settings
from lipservo.settings.sections import SoundSettings
from lipsync.audio.file import FileSource, checked_sound, log_once, played_chunks
from lipsync.audio.playout import ListenedMicrophone, Playout
from lipsync.audio.playout_stream import PlayoutRequest, PlayoutStream
from lipsync.audio.silent_loudspeaker import SilentLoudspeaker
from lipsync.audio.source import AudioSource, Loudspeaker, SilenceAfter, SilentSource
from lipsync.errors import UserError
from lipsync.phoneme_files.label_file import LabelFile
from lipsync.phonemes import PhonemeEvent
from lipsync.spoken_text import LONGEST_LABEL, LONGEST_TEXT, SpokenText, SpokenUnit

if TYPE_CHECKING:
    from lipservo_client.vendors import TimedUnit

    from lipsync.text_to_speech.synthesis import SynthesizedSpeech, Voice

_LOG: Final = logging.getLogger(__name__)


def open_sound(sound: Sound, start_s: float = 0.0) -> AudioSource:
    """Return the source of a file, clip, microphone or silence, not yet entered.

    start_s: the sound time at which a file starts; its blocks keep the file's times. A file is
    checked here, in a time that does not depend on its length. Raises SoundError.
    """
    if sound.kind == "microphone":
        return open_microphone(sound.name, sound.channel)
    if sound.kind == "silence":
        return SilentSource(start_s)
    if sound.kind == "file":
        return _file_source(Path(sound.name), start_s, sound.channel)
    with resources.as_file(resources.files("lipservo.clips") / "welcome.flac") as clip:
        return _file_source(clip, start_s)


def open_microphone(device: str, channel: str = "") -> AudioSource:
    """Return a microphone source by number, part of a name, or "default". Raises SoundError.

    channel: the one that is heard; "": all are mixed.
    """
    from lipsync.audio.microphone import MicrophoneSource

    return MicrophoneSource(None if device == DEFAULT_MICROPHONE else device, channel=channel)


def _file_source(path: Path, start_s: float, channel: str = "") -> AudioSource:
    return SilenceAfter(FileSource(path, start_s=start_s, channel=channel), start_s)


#: Texts, sounds and performances that are spoken or wait, together.
MOST_WAITING: Final = 8
#: Decoding and synthesis pause while more seconds of sound than this wait to be spoken.
_SOUND_AHEAD_S: Final = 5.0
#: For a text: a sentence or two.
_TEXT_AHEAD_S: Final = 20.0
#: Sentences of one text that wait; each is a request to the playout, which keeps 64 from all.
_SENTENCES_AHEAD: Final = 4
_POLL_S: Final = 0.1
_END_S: Final = 2.0
_LANGUAGE: Final = "en-us"
#: Characters of a file's name.
_LONGEST_NAME: Final = 250
#: The name of the streams of a text, one for each sentence.
_TEXT: Final = "text"


class QueueFullError(UserError):
    """The error that the speech queue has no room for another item; the message is one line."""


@dataclass(eq=False, slots=True)
class SpeechItem:
    """One item of speech to play: one stream of sound, or several, one after another.

    pieces: a generator; each `next` does a bounded piece of work and yields the stream it belongs
    to. streams: those not yet spoken, at first the first one alone. ahead_s: the work pauses while
    more seconds of sound than this wait to be spoken. duration_s: of all chunks where known
    beforehand (a file), else of the streams made so far (a text). is_cut_short: it was cut off, or
    its synthesis or decoding failed, so that some of it is never spoken.
    """

    pieces: Generator[PlayoutStream, None, None]
    streams: deque[PlayoutStream]
    ahead_s: float
    duration_s: float
    is_whole: bool = field(default=False, init=False)
    is_cut_short: bool = field(default=False, init=False)
    n_streams: int = field(default=1, init=False)

    @property
    def is_dropped(self) -> bool:
        """Whether the speech was cut off, so that no more of it is spoken."""
        return self.streams[-1].is_dropped

    @property
    def is_over(self) -> bool:
        """Whether the speech was cut off or spoken to its end."""
        return self.is_dropped or (self.is_whole and self.streams[-1].is_over)

    @property
    def is_ahead(self) -> bool:
        """Whether so much of the speech waits to be spoken that its synthesis may pause.

        Streams that are over are removed from `streams`, but the last one.
        """
        while len(self.streams) > 1 and self.streams[0].is_over:
            self.streams.popleft()
        waiting_s = sum(stream.waiting_s for stream in self.streams)
        return waiting_s > self.ahead_s or len(self.streams) > _SENTENCES_AHEAD


def spoken_chunks(
    chunks: Iterator[NDArray[np.float32]], stream: PlayoutStream, duration_s: float
) -> SpeechItem:
    """Return speech that pushes chunks of sound into an empty stream of their rate.

    Parameters
    ----------
    chunks : Iterator[NDArray[np.float32]]
        (n,) mono samples each.
    stream : PlayoutStream
        The empty stream.
    duration_s : float
        Duration of all chunks together, s.

    Returns
    -------
    SpeechItem
        Speech whose pieces push one chunk each.
    """

    def pieces() -> Generator[PlayoutStream, None, None]:
        for chunk in chunks:
            stream.push(chunk)
            yield stream

    return SpeechItem(pieces(), deque([stream]), _SOUND_AHEAD_S, duration_s)


def spoken_file(
    path: Path,
    playout: Playout,
    name: str = "",
    *,
    start_s: float = 0.0,
    phonemes: LabelFile | None = None,
    channel: str = "",
) -> SpeechItem:
    """Return speech for the queue that plays a sound file from `start_s` to its end.

    playout: plays the speech later. name: of its stream; empty: the file's name. phonemes: a file
    with the sound's phonemes or words and their times. channel: the one that is played and moves
    the mouth; "": a mix of all. What is damaged after the first minute is silence, and counts as
    lost sound. Raises SoundError, LabelError.
    """
    checked = checked_sound(path, channel)
    log_once(checked.warning)
    known, words = (
        ((), ()) if phonemes is None else _labels_from(phonemes, start_s, checked.duration_s)
    )
    rate_hz = checked.sample_rate_hz
    stream = PlayoutStream(name or path.name, rate_hz, playout.output_rate_hz, known)
    if words:
        units = tuple(SpokenUnit(each.label, round(each.start_s * rate_hz)) for each in words)
        _give_units(stream, SpokenText("word", units, rate_hz), _LANGUAGE)

    def lose(n_lost: int, trouble: str) -> None:
        playout.lost.append(n_lost)
        log_once(f"{path}: {trouble}")

    chunks = played_chunks(path, checked, round(start_s * rate_hz), lose)
    return spoken_chunks(chunks, stream, max(0.0, checked.duration_s - start_s))


def spoken_text(text: str, playout: Playout, speaker: "Speaker", name: str = _TEXT) -> SpeechItem:
    """Return speech of a text for the queue; its first sentence is synthesised before returning.

    playout: plays the speech later. speaker: the synthesiser and voice. name: of the streams, one
    for each sentence. Raises SynthesisError, also for a text of more than `LONGEST_TEXT`
    characters, and PluginError.
    """
    from lipsync.text_to_speech.synthesis import checked_text
    from lipsync.text_to_speech.synthesizers import speak_in_pieces, synthesizer_for

    checked_text(text, LONGEST_TEXT)
    voice = voice_of(speaker)
    sentences = speak_in_pieces(synthesizer_for(speaker.synthesizer), text, voice)

    def stream_of(sentence: "SynthesizedSpeech") -> PlayoutStream:
        """Return a complete stream of one sentence: sound, and phonemes or words with times."""
        rates_hz = sentence.sample_rate_hz, playout.output_rate_hz
        stream = PlayoutStream(name, *rates_hz, sentence.phonemes)
        stream.push(sentence.samples)
        if sentence.units is not None:
            _give_units(stream, sentence.units, voice.language)
        else:
            starts = (round(word.start_s * sentence.sample_rate_hz) for word in sentence.words)
            labels = (word.text[:LONGEST_LABEL] for word in sentence.words)
            units = map(SpokenUnit, labels, starts)
            stream.tell(SpokenText("word", tuple(units), sentence.sample_rate_hz))
        stream.end()
        return stream

    def pieces(last: PlayoutStream) -> Generator[PlayoutStream, None, None]:
        for sentence in sentences:
            stream = stream_of(sentence)
            playout.requests.append(PlayoutRequest("say", stream, after=last))
            yield stream
            last = stream

    first = stream_of(next(sentences))
    sounding_s = first.n_received / first.sample_rate_hz
    return SpeechItem(pieces(first), deque([first]), _TEXT_AHEAD_S, sounding_s)


def _give_units(stream: PlayoutStream, units: SpokenText, language: str) -> None:
    """Give a stream its spoken words, `units`, with their pronunciation.

    If a word has none, a warning is logged, no words are given, and the stream's sound is
    recognised like any other.
    """
    from lipsync.text_to_speech.pronunciation import PronunciationError, pronounced_units

    try:
        stream.tell(units, pronounced_units(units, language))
    except PronunciationError as error:
        _LOG.warning("%s; this voice is heard like any other", error)


@dataclass(frozen=True, slots=True)
class Speaker:
    """The synthesiser that speaks a face's texts, by name; its voice, as `Voice` has it."""

    synthesizer: str
    voice: str = ""
    language: str = ""
    rate_wpm: int = 175
    pitch: int = 50

    def changed(
        self, language: str | None, voice: str | None, rate_wpm: int | None, pitch: int | None
    ) -> "Speaker":
        """Return the speaker with other values for one text; None: as in this one."""
        return Speaker(
            self.synthesizer,
            self.voice if voice is None else voice,
            language or self.language,
            rate_wpm or self.rate_wpm,
            self.pitch if pitch is None else pitch,
        )


def speaker_of(settings: SoundSettings, folder: Path | None) -> Speaker:
    """Return the synthesiser and voice that a face's YAML names.

    folder: of the YAML; a voice that names a file in it becomes that file's path.
    """
    beside = (folder or Path()) / settings.voice
    is_file = bool(settings.voice) and len(settings.voice) < _LONGEST_NAME and beside.is_file()
    voice = str(beside) if is_file else settings.voice
    return Speaker(settings.synthesizer, voice, settings.language)


def voice_of(speaker: Speaker) -> "Voice":
    """Return a speaker's voice; its language is American English where none is set."""
    from lipsync.text_to_speech.synthesis import Voice

    return Voice(speaker.language or _LANGUAGE, speaker.voice, speaker.rate_wpm, speaker.pitch)


class SpeechQueue:
    """A queue of at most `MOST_WAITING` speech items, spoken in the order of their addition.

    An interruption of the playout drops all items that were added before it.
    """

    def __init__(self, playout: Playout) -> None:
        """Create an empty queue, whose items `playout` plays; no thread runs before the first."""
        self._playout = playout
        self._changed = threading.Condition()
        #: Items that are spoken or wait; those in `_unfinished` are still to be decoded or
        #: synthesised, the first of them now.
        self._items: list[SpeechItem] = []
        self._unfinished: deque[SpeechItem] = deque()
        self._closed = False
        self._thread: threading.Thread | None = None

    def check_room(self, name: str) -> None:
        """Raise QueueFullError if the queue is full. name: of the new item, for the message."""
        with self._changed:
            self._items = [each for each in self._items if not each.is_over]
            if len(self._items) >= MOST_WAITING:
                raise QueueFullError(
                    f"{name}: {MOST_WAITING} texts, sounds or performances already wait or are "
                    "spoken; try again later, or interrupt them"
                )

    def add(self, spoken: SpeechItem, name: str) -> None:
        """Append an item, and request its first stream from the playout. Raises QueueFullError.

        Does nothing once the queue is closed. name: of the item, for the message.
        """
        with self._changed:
            self.check_room(name)
            if self._closed:
                return
            self._playout.announced.add(spoken)
            self._playout.requests.append(PlayoutRequest("say", spoken.streams[0]))
            self._items.append(spoken)
            self._unfinished.append(spoken)
            if self._thread is None:
                self._thread = threading.Thread(target=self._work, name="speech queue", daemon=True)
                self._thread.start()
            self._changed.notify()

    def close(self) -> None:
        """Stop reading and synthesising; wait up to 2 s for the thread that does it."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        if self._thread is not None:
            self._thread.join(timeout=_END_S)

    def _work(self) -> None:
        """Decode or synthesise the queued items, one after the other, until the queue is closed.

        Runs in thread `speech queue`; pauses while enough of an item waits to be spoken. Items that
        were cut off, and all once the queue is closed, are finished without further work.
        """
        while True:
            with self._changed:
                while not self._unfinished and not self._closed:
                    self._changed.wait()
                if not self._unfinished:
                    return
                item = self._unfinished[0]
                if not (self._closed or item.is_dropped) and item.is_ahead:
                    self._changed.wait(_POLL_S)
                    continue
                is_cut = self._closed or item.is_dropped
            item.is_cut_short = item.is_cut_short or is_cut
            if is_cut or not self._do_next_piece(item):
                self._finish(item)

    def _do_next_piece(self, item: SpeechItem) -> bool:
        """Do the next piece of an item's work; return False if none is left or the piece failed."""
        try:
            stream = next(item.pieces, None)
        except Exception as error:  # ends this item; the others are still spoken
            what = "" if isinstance(error, UserError) else f"{type(error).__name__}: "
            _LOG.error("%s%s; only the part before it is spoken", what, error)
            item.is_cut_short = True
            return False
        if stream is not None and stream is not item.streams[-1]:
            item.streams.append(stream)
            item.n_streams += 1
            item.duration_s += stream.n_received / stream.sample_rate_hz
        return stream is not None

    def _finish(self, item: SpeechItem) -> None:
        """Mark all streams of an item as complete; remove the item from those still to be read."""
        item.pieces.close()
        for stream in item.streams:
            stream.end()
        # The playout need not wait for further streams of it.
        item.is_whole = True
        self._playout.announced.discard(item)
        with self._changed:
            self._unfinished.popleft()


def _labels_from(
    file: LabelFile, start_s: float, sound_s: float
) -> tuple[tuple[PhonemeEvent, ...], tuple["TimedUnit", ...]]:
    """Return a file's phonemes or words that begin at `start_s` or later, in s after `start_s`.

    sound_s: duration of the whole sound. Raises LabelError.
    """
    from lipsync.phoneme_files.reader import read_labels

    labels = read_labels(file, sound_s)
    return (
        tuple(each.later(-start_s) for each in labels.phones if each.start_s >= start_s),
        tuple(
            each._replace(start_s=each.start_s - start_s)
            for each in labels.words
            if each.start_s >= start_s
        ),
    )


@contextmanager
def entered_sound(request: RunRequest, start_s: float = 0.0) -> Iterator[AudioSource]:
    """Yield the audio source of a request, open: a `Playout` for a face that speaks.

    start_s: the sound time at which a file starts. Raises SoundError.
    """
    face_settings, folder = load_settings(request.config)
    settings = face_settings.sound
    request = replace(request, sound=_with_face_defaults(request.sound, settings))
    if request.voice is None:
        with open_sound(request.sound, start_s) as source:
            yield source
        return
    with ExitStack() as stack:
        loudspeaker = _entered_loudspeaker(settings, request.voice, stack)
        microphone = None
        if request.sound.kind == "microphone":
            device = stack.enter_context(open_microphone(request.sound.name, request.sound.channel))
            microphone = ListenedMicrophone(device)
        playout = Playout(loudspeaker, microphone)
        first = _first_speech(request.sound, playout, start_s, stack, speaker_of(settings, folder))
        if first is not None:
            queue = SpeechQueue(playout)
            stack.callback(queue.close)
            queue.add(first, request.sound.name)
        yield playout


def check_sound(request: RunRequest) -> None:
    """Raise SoundError if a request's sound file cannot be used; no device is opened."""
    if request.sound.kind == "file":
        open_sound(request.sound)


def _with_face_defaults(sound: Sound, settings: SoundSettings) -> Sound:
    """Return the sound with the face's microphone and channel in place of the defaults."""
    if sound.kind in ("file", "microphone"):
        sound = replace(sound, channel=sound.channel or settings.channel)
    if (sound.kind, sound.name) != ("microphone", DEFAULT_MICROPHONE):
        return sound
    return replace(sound, name=settings.input or DEFAULT_MICROPHONE)


def _entered_loudspeaker(
    settings: SoundSettings, voice: VoiceOptions, stack: ExitStack
) -> Loudspeaker | None:
    """Return the chosen loudspeaker, open until `stack` closes; None: no sound is played."""
    if voice.output is None:
        return None
    if voice.output == SILENT_OUTPUT:
        return SilentLoudspeaker()
    from lipsync.audio.loudspeaker import LoudspeakerOutput

    device = settings.output if voice.output == DEFAULT_OUTPUT else voice.output
    return stack.enter_context(
        LoudspeakerOutput(device, settings.output_offset_ms, volume=settings.volume)
    )


def _first_speech(
    sound: Sound, playout: Playout, start_s: float, stack: ExitStack, speaker: Speaker
) -> SpeechItem | None:
    """Return the speech of a requested text, file or bundled clip; None: the face begins silent.

    start_s: where a file begins, in s. stack: keeps the clip's file until it closes.
    """
    if sound.kind == "text":
        changed = speaker.changed(sound.language, sound.voice, sound.rate_wpm, sound.pitch)
        return spoken_text(sound.name, playout, changed)
    if sound.kind not in ("file", "clip"):
        return None
    path = Path(sound.name)
    if sound.kind == "clip":
        clip = resources.files("lipservo.clips") / "welcome.flac"
        path = stack.enter_context(resources.as_file(clip))
    labels = LabelFile(Path(sound.phonemes), sound.tier, sound.alphabet)
    known = labels if sound.phonemes else None
    return spoken_file(path, playout, start_s=start_s, phonemes=known, channel=sound.channel)
