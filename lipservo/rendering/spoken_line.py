"""The phonemes of a sound file: from a file of phones, from its text, or by the recogniser."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from lipservo_client.vendors import TimedUnit

from lipservo.runtime.settled_phonemes import settled_events
from lipsync.audio.file import FileSource, checked_sound, read_speech
from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.errors import UserError
from lipsync.offline.line_methods import Line
from lipsync.offline.line_synthesis import joined_phones
from lipsync.phoneme_files.label_file import LabelFile
from lipsync.phoneme_files.reader import read_labels
from lipsync.phonemes import SILENCE, PhonemeEvent
from lipsync.recognition.alignment import (
    DOUBTFUL_SCORE,
    LEAST_SCORE,
    AlignmentError,
    align,
    goodness_of_pronunciation,
)
from lipsync.recognition.network import load_shipped_weights
from lipsync.recognition.posteriors import whole_posteriors
from lipsync.recognition.recognizers import make_recognizer
from lipsync.spoken_text import PronouncedWord, SpokenText, SpokenUnit
from lipsync.text_to_speech.pronunciation import pronounced_units

#: A line is recognised as a whole; a longer sound must be cut into lines beforehand.
LONGEST_LINE_S = 300.0


class LineError(UserError):
    """Error for a sound that cannot be rendered as a line: which one, why, and the remedy."""


@dataclass(frozen=True, slots=True)
class Script:
    """What is known of a sound's speech.

    phones: labels of phones or words. text: the sound's words. With neither the recogniser finds
    the phonemes. channel: the sound channel that is used; "": all are mixed.
    """

    phones: LabelFile | None = None
    text: str | None = None
    channel: str = ""


def spoken_line(sound: Path, script: Script) -> tuple[Line, tuple[str, ...]]:
    """Return the samples and phones of a sound file as a line, and notes for a person.

    The phones are those of the script's labels; else its text is aligned with the sound; else they
    are recognised, along the labelled words if there are any. Raises SoundError, LabelError,
    AlignmentError, PronunciationError, and LineError for a sound longer than `LONGEST_LINE_S`.
    """
    duration_s = checked_sound(sound, script.channel).duration_s
    if duration_s > LONGEST_LINE_S:
        raise LineError(
            f"{sound}: is {duration_s:.0f} s long, and a line at most {LONGEST_LINE_S:.0f} s; cut "
            "it into lines"
        )
    notes: list[str] = []
    posteriors = None
    samples = read_speech(sound, script.channel)
    duration_s = len(samples) / SAMPLE_RATE_HZ
    labels = None if script.phones is None else read_labels(script.phones, duration_s)
    events: tuple[PhonemeEvent, ...]
    if labels is not None and labels.phones:
        events = labels.phones
    elif script.text is not None:
        events = align(samples, script.text).phones
        score = goodness_of_pronunciation(samples, events)
        if score < LEAST_SCORE:
            raise AlignmentError(
                f"{sound}: its speech is not this text (score {score:.2f}; spoken texts score "
                f"above {LEAST_SCORE}); check the text"
            )
        if score < DOUBTFUL_SCORE:
            notes.append(f"the text fits badly (score {score:.2f})")
    else:
        recognizer = make_recognizer("network")
        if labels is not None:
            recognizer.tell(pronounced_words(labels.words))
        events = tuple(settled_events(FileSource(sound, channel=script.channel), recognizer))
        notes += recognizer.reasons
        posteriors = whole_posteriors(load_shipped_weights(), samples)
    phones = joined_phones(events, duration_s)
    if all(event.phoneme == SILENCE for event in phones):
        notes.append("no speech: the mouth stays at rest")
    return Line(phones, samples, posteriors), tuple(notes)


def pronounced_words(words: Sequence[TimedUnit]) -> tuple[PronouncedWord, ...]:
    """Return the words of a label file with their pronunciations. Raises PronunciationError."""
    units = (SpokenUnit(word.label, round(word.start_s * SAMPLE_RATE_HZ)) for word in words)
    return pronounced_units(SpokenText("word", tuple(units), SAMPLE_RATE_HZ))


def given_text(text: str) -> str:
    """Return `text`, or the content of the file that it names, if there is one.

    Raises LineError if the file cannot be read.
    """
    if not is_file(text):
        return text
    try:
        return Path(text).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise LineError(f"{text}: cannot be read as text (UTF-8): {error}") from error


def is_file(text: str) -> bool:
    """Return whether a text is the name of an existing file; one too long for a name is not."""
    try:
        return Path(text).is_file()
    except OSError:  # a text too long for a file's name
        return False
