"""espeak-ng's C library by ctypes: text in, sound and events out.

Names and numbers are those of espeak-ng/speak_lib.h, version 1.51. The library has one state for
the whole process and is not thread safe: one thread of a process of its own uses it
(`espeak_process`). Why no package of Python's: docs/decisions/speech-out.md.
"""

import ctypes
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lipsync.text_to_speech.synthesis import SynthesisError, Voice

_LIBRARY = "libespeak-ng.so.1"
_AUDIO_OUTPUT_SYNCHRONOUS = 2  # sound goes to the callback; a call returns when all is spoken
_PHONEME_EVENTS, _PHONEME_IPA, _DONT_EXIT = 0x0001, 0x0002, 0x8000
#: Neither SSML nor phonemes in brackets, text is text; a pause at the end as between sentences.
_CHARS_UTF8, _ENDPAUSE = 1, 0x1000
_POS_CHARACTER = 1
_RATE, _PITCH = 1, 3
_EVENT_LIST_TERMINATED, _EVENT_WORD, _EVENT_PHONEME = 0, 1, 7
_FULL_SCALE = 32768.0


class _EventId(ctypes.Union):
    _fields_ = (
        ("number", ctypes.c_int),
        ("name", ctypes.c_char_p),
        ("string", ctypes.c_char * 8),
    )


class _Event(ctypes.Structure):
    _fields_ = (
        ("type", ctypes.c_int),
        ("unique_identifier", ctypes.c_uint),
        ("text_position", ctypes.c_int),
        ("length", ctypes.c_int),
        ("audio_position", ctypes.c_int),
        ("sample", ctypes.c_int),
        ("user_data", ctypes.c_void_p),
        ("id", _EventId),
    )


class _VoiceRecord(ctypes.Structure):
    _fields_ = (
        ("name", ctypes.c_char_p),
        ("languages", ctypes.c_void_p),  # for each: a byte of priority, a name, a zero; then zero
        ("identifier", ctypes.c_char_p),
        ("gender", ctypes.c_ubyte),
        ("age", ctypes.c_ubyte),
        ("variant", ctypes.c_ubyte),
        ("xx1", ctypes.c_ubyte),
        ("score", ctypes.c_int),
        ("spare", ctypes.c_void_p),
    )


_Callback = ctypes.CFUNCTYPE(
    ctypes.c_int, ctypes.POINTER(ctypes.c_short), ctypes.c_int, ctypes.POINTER(_Event)
)


@dataclass(frozen=True, slots=True)
class PhonemeMark:
    """A mark of espeak-ng: the phoneme `ipa` begins at sample number `sample`; "" is a pause."""

    ipa: str
    sample: int


@dataclass(frozen=True, slots=True)
class WordMark:
    """A mark of espeak-ng: a word of `length` characters begins at text `position` (0: first)."""

    position: int
    length: int


@dataclass(frozen=True, slots=True)
class Synthesis:
    """The speech of a text by the library: float32 samples in [-1, 1], and marks in order."""

    samples: NDArray[np.float32]
    sample_rate_hz: int
    marks: tuple[PhonemeMark | WordMark, ...]


class EspeakLibrary:
    """The loaded library espeak-ng; one per process, to be used by one thread."""

    def __init__(self, library: ctypes.CDLL, data_path: str | None) -> None:
        """Initialise the library for synthesis in memory, and list its voices.

        data_path: folder of its voice data; None: the system's. Raises SynthesisError without them.
        """
        self._library = library
        self._chunks: list[NDArray[np.int16]] = []
        self._marks: list[PhonemeMark | WordMark] = []
        library.espeak_ListVoices.restype = ctypes.POINTER(ctypes.POINTER(_VoiceRecord))
        library.espeak_Synth.argtypes = (
            *(ctypes.c_void_p, ctypes.c_size_t, ctypes.c_uint, ctypes.c_int, ctypes.c_uint),
            *(ctypes.c_uint, ctypes.c_void_p, ctypes.c_void_p),
        )
        rate_hz = library.espeak_Initialize(
            _AUDIO_OUTPUT_SYNCHRONOUS,
            0,
            data_path.encode() if data_path is not None else None,
            _PHONEME_EVENTS | _PHONEME_IPA | _DONT_EXIT,
        )
        if rate_hz <= 0:
            raise SynthesisError(
                "espeak-ng's voice data are not installed: `apt install espeak-ng-data`"
            )
        self._sample_rate_hz = int(rate_hz)
        # The library keeps the pointer only: the callback must be kept alive here.
        self._callback = _Callback(self._store_chunk)
        library.espeak_SetSynthCallback(self._callback)
        self._voice_of = self._list_voices()

    def languages(self) -> tuple[str, ...]:
        """Return the tags of all languages that have a voice, in alphabetical order."""
        return tuple(sorted(self._voice_of))

    def synthesize(self, text: str, voice: Voice) -> Synthesis:
        """Return sound and marks of a text without control characters.

        voice: its `language` is one of `languages()`. Raises SynthesisError if the library fails.
        """
        encoded = ctypes.create_string_buffer(text.encode("utf-8"))
        self._chunks, self._marks = [], []
        self._check(self._library.espeak_SetVoiceByName(self._voice_of[voice.language]))
        self._check(self._library.espeak_SetParameter(_RATE, voice.rate_wpm, 0))
        self._check(self._library.espeak_SetParameter(_PITCH, voice.pitch, 0))
        size = ctypes.sizeof(encoded)
        flags = _CHARS_UTF8 | _ENDPAUSE
        self._check(
            self._library.espeak_Synth(encoded, size, 0, _POS_CHARACTER, 0, flags, None, None)
        )
        chunks, marks = self._chunks, tuple(self._marks)
        self._chunks, self._marks = [], []
        samples = np.concatenate([np.zeros(0, np.int16), *chunks])
        return Synthesis((samples / _FULL_SCALE).astype(np.float32), self._sample_rate_hz, marks)

    def _store_chunk(self, sound: object, n: int, events: object) -> int:
        """Store `n` samples of sound and the marks in `events`; called back by the library."""
        if sound and n > 0:
            self._chunks.append(np.ctypeslib.as_array(sound, (n,)).copy())
        index = 0
        while (event := events[index]).type != _EVENT_LIST_TERMINATED:  # type: ignore[index]
            if event.type == _EVENT_PHONEME:
                # Eight bytes at most, so that the last letter may be cut in two.
                ipa = event.id.string.decode("utf-8", "ignore")
                self._marks.append(PhonemeMark(ipa, event.sample))
            elif event.type == _EVENT_WORD:
                self._marks.append(WordMark(event.text_position - 1, event.length))
            index += 1
        return 0

    def _check(self, status: int) -> None:
        """Raise SynthesisError for a status of the library other than 0."""
        if status != 0:
            raise SynthesisError(f"espeak-ng failed with status {status}; try another language")

    def _list_voices(self) -> dict[str, bytes]:
        """Return the library's identifier of the best voice for each language tag."""
        best: dict[str, tuple[int, bytes]] = {}
        records = self._library.espeak_ListVoices(None)
        index = 0
        while records[index]:
            record = records[index].contents
            for tag, priority in _languages(record.languages):
                best[tag] = min(best.get(tag, (256, b"")), (priority, record.identifier))
            index += 1
        return {tag: identifier for tag, (_, identifier) in best.items()}


def _languages(address: int) -> list[tuple[str, int]]:
    """Return (tag, priority) of each language in a voice's list at the memory `address`.

    The smaller the priority, the better the voice speaks the language.
    """
    languages = []
    while priority := ctypes.string_at(address, 1)[0]:
        tag = ctypes.string_at(address + 1)
        languages.append((tag.decode("utf-8", "replace"), priority))
        address += len(tag) + 2
    return languages


def load_library() -> EspeakLibrary:
    """Return the espeak-ng of the system, else the one in the package espeakng-loader.

    The library passes its sound to the object loaded last. Raises SynthesisError if neither is
    installed, or its voices' data are missing.
    """
    try:
        return EspeakLibrary(ctypes.CDLL(_LIBRARY), None)
    except OSError:
        if find_spec("espeakng_loader") is None:
            raise SynthesisError(
                "espeak-ng is not installed: `apt install espeak-ng`, "
                "or `pip install 'lipservo[say]'`"
            ) from None
    import espeakng_loader

    library = ctypes.CDLL(espeakng_loader.get_library_path())
    return EspeakLibrary(library, str(Path(espeakng_loader.get_data_path())))
