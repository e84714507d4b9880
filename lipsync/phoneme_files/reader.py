"""Readers of files of phonemes and their times; the format is detected by the content."""

import json
from dataclasses import replace
from itertools import pairwise
from os import PathLike
from pathlib import Path
from typing import Final

from lipservo_client.vendors import TimedUnit, VendorError, VendorUnits, vendor_units

from lipsync.alphabets import ARPABET, AlphabetError, phones_of
from lipsync.errors import UserError
from lipsync.phonemes import SILENCE, PhonemeEvent
from lipsync.textgrid import LabelError, is_textgrid, read_phonemes

#: An hour of phonemes in JSON is about 4 MB.
_LARGEST_BYTES: Final = 64 * 2**20
_KNOWN: Final = (
    "known are TextGrid, phones as `lipservo lines align -o` writes them, and what synthesisers "
    "send (docs/text.md)"
)
_SOUND_ENDINGS: Final = (".wav", ".flac", ".ogg", ".opus", ".mp3")
#: A file that tells starts alone does not say how long its last phoneme is.
_LAST_PHONEME_S: Final = 0.1


def read_known_phonemes(path: str | PathLike[str]) -> tuple[PhonemeEvent, ...]:
    """Return the phonemes of a file in one of the formats of docs/text.md.

    They are in order, from 0 s on, without gaps (silence between) and each with its end. Raises
    LabelError, in one line: which file, which position in it, what is allowed.
    """
    content = _content(Path(path))
    if is_textgrid(content[:200]):
        return read_phonemes(path)
    return phonemes_in(content, str(path))


def read_words(path: str | PathLike[str]) -> tuple[TimedUnit, ...]:
    """Return the words of a file that has word times alone; () if it has phonemes or visemes."""
    content = _content(Path(path))
    if is_textgrid(content[:200]):
        return ()
    best = units_in(content, str(path))[0]
    return best.units if best.kind == "word" else ()


def sound_beside(path: Path) -> Path:
    """Return the sound file beside `path` that has the same name but for the ending, such as .wav.

    Raises LabelError if there is none.
    """
    for ending in _SOUND_ENDINGS:
        if (sound := path.with_suffix(ending)).is_file():
            return sound
    raise LabelError(
        f"{path}: no sound beside it; put it there as {path.stem} with "
        f"{', '.join(_SOUND_ENDINGS)}, or give both to `lipservo run --wav SOUND --phonemes FILE`"
    )


def phonemes_in(content: bytes, name: str) -> tuple[PhonemeEvent, ...]:
    """Return the phonemes in a JSON file's content.

    Raises LabelError, with the file's `name` in the message, if the content is invalid or has words
    alone.
    """
    best = units_in(content, name)[0]
    if best.kind == "word":
        raise LabelError(
            f"{name}: words without phonemes; `lipservo say --from` follows them in the sound"
        )
    return events_of(best, name)


def units_in(content: bytes, name: str) -> tuple[VendorUnits, ...]:
    """Return the units in a JSON file's content by kind: phonemes first, then visemes, then words.

    Raises LabelError, with the file's `name` in the message, if the content has none of them.
    """
    try:
        return vendor_units(_parsed(content, name))
    except VendorError as error:
        raise LabelError(f"{name}: {error}") from None


def _content(path: Path) -> bytes:
    try:
        if path.stat().st_size > _LARGEST_BYTES:
            raise LabelError(f"{path}: larger than 64 MiB; give the phonemes of one recording")
        return path.read_bytes()
    except OSError as error:
        raise LabelError(f"{path}: cannot be read ({error.strerror}); give a file") from None


def events_of(known: VendorUnits, name: str) -> tuple[PhonemeEvent, ...]:
    """Return phonemes or visemes as events from 0 s on; phones of one unit share its time evenly.

    name: of the file, for errors. Raises LabelError for a label that is not in the units' alphabet,
    and for units that are all silence.
    """
    events: list[PhonemeEvent] = []
    ends_s = [after.start_s for _, after in pairwise(known.units)]
    last = known.units[-1]
    ends_s.append(last.start_s + _LAST_PHONEME_S if last.end_s is None else last.end_s)
    reached_s = 0.0
    for number, (unit, next_s) in enumerate(zip(known.units, ends_s, strict=True), start=1):
        try:
            phones = phones_of(unit.label, known.alphabet or ARPABET)
        except AlphabetError as error:
            raise LabelError(f"{name}: {known.kind} {number}: {error}") from None
        end_s = next_s if unit.end_s is None else unit.end_s
        if unit.start_s > reached_s:
            _append(events, SILENCE, reached_s, unit.start_s)
        goes_on = not phones  # a mark of length, a space
        if goes_on:
            phones = (events[-1].phoneme if events else SILENCE,)
        share_s = (end_s - unit.start_s) / len(phones)
        bounds_s = [unit.start_s + n * share_s for n in range(len(phones))] + [end_s]
        for phone, (start_s, stop_s) in zip(phones, pairwise(bounds_s), strict=True):
            _append(events, phone, start_s, stop_s, goes_on=goes_on)
        reached_s = max(reached_s, end_s)
    if last.end_s is None and events and events[-1].phoneme == SILENCE:
        del events[-1]
    if all(event.phoneme == SILENCE for event in events):
        raise LabelError(f"{name}: nothing but silence; give one with phonemes")
    return tuple(events)


def _append(
    events: list[PhonemeEvent], phone: str, start_s: float, end_s: float, *, goes_on: bool = False
) -> None:
    """Append `phone` from `start_s` to `end_s` to the events, unless it has no length.

    Silence, or any phone if `goes_on`, extends a last event of the same phone instead.
    """
    if end_s <= start_s:
        return
    if events and events[-1].phoneme == phone and (goes_on or phone == SILENCE):
        events[-1] = replace(events[-1], end_s=end_s)
    else:
        events.append(PhonemeEvent(phone, start_s, end_s))


def _parsed(content: bytes, name: str) -> object:
    """Return the parsed JSON document, or for JSON Lines a dict of parsed lines by `line N`.

    Raises LabelError, with the file's `name` in the message, if the content is neither.
    """
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise LabelError(f"{name}: neither a TextGrid nor text in UTF-8; {_KNOWN}") from None
    try:
        return _json(text)
    except _NotJsonError:
        pass
    lines: dict[str, object] = {}
    for number, line in enumerate(text.split("\n"), start=1):
        if line.strip():
            try:
                lines[f"line {number}"] = _json(line)
            except _NotJsonError:
                raise LabelError(f"{name}: line {number}: no JSON; {_KNOWN}") from None
    if not lines:
        raise LabelError(f"{name}: empty; {_KNOWN}")
    return lines


class _NotJsonError(UserError):
    pass


def _json(text: str) -> object:
    try:
        return json.loads(text)
    # Numbers of thousands of digits are a ValueError, brackets in thousands a RecursionError.
    except (ValueError, RecursionError):
        raise _NotJsonError from None
