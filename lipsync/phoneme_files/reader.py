"""The reader of label files of any program, for every command: phonemes or words with times.

Nothing is guessed: a file that leaves tier or alphabet in doubt is refused, and the message names
the option that decides. layouts.py has the formats.
"""

import logging
import os.path
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from os import PathLike
from pathlib import Path
from typing import Final

from lipservo_client.alphabet import UNSPELT, VendorError, alphabet_of
from lipservo_client.vendors import TimedUnit

from lipsync.alphabets import AlphabetError, phones_of
from lipsync.errors import shown
from lipsync.phoneme_files.label_file import LabelFile
from lipsync.phoneme_files.layouts import Tier, kind_of, tiers_in
from lipsync.phonemes import SILENCE, PhonemeEvent
from lipsync.textgrid import LabelError, decode_labels, read_text

_LOG: Final = logging.getLogger(__name__)

_SOUND_ENDINGS: Final = (".wav", ".flac", ".ogg", ".opus", ".mp3")
#: Duration of the last phoneme in a file that has only starts.
_LAST_PHONEME_S: Final = 0.1
#: A gap or an overlap shorter than this is closed: files round their times.
_EDGE_S: Final = 0.001
#: Labels may end so much after their sound, as aligners work in frames, and pad. A note is made
#: where so large a share of the sound, and more than 0.3 s, has no labels at its end.
_AFTER_SOUND_S, _UNLABELLED = 0.25, 0.25


@dataclass(frozen=True, slots=True)
class Labels:
    """What a label file says of its sound: phonemes with times, or words if it has no phonemes.

    phones: in order, from 0 s on, without gaps (silence between), each with its end. notes: what
    was left out or is doubtful, a line each.
    """

    phones: tuple[PhonemeEvent, ...]
    words: tuple[TimedUnit, ...] = ()
    notes: tuple[str, ...] = ()


def read_labels(file: LabelFile, sound_s: float | None = None) -> Labels:
    """Return the labels of a file in one of the formats of docs/text.md; its notes are logged.

    sound_s: duration of the sound that they belong to; None: not known. Raises LabelError, in one
    line: which file, which position in it, what is allowed.
    """
    labels = labels_in(None, file, sound_s)
    for note in labels.notes:
        _LOG.warning("%s: %s", file.path, note)
    return labels


def read_phonemes(
    path: str | PathLike[str], sound_s: float | None = None
) -> tuple[PhonemeEvent, ...]:
    """Return the phonemes of a label file, as `read_labels` does. LabelError for words alone."""
    labels = read_labels(LabelFile(Path(path)), sound_s)
    if labels.words:
        raise LabelError(
            f"{path}: has words but no phonemes; `lipservo say --from` finds both in the sound"
        )
    return labels.phones


def has_phones(tiers: Iterable[str]) -> bool:
    """Return whether one of the named tiers is of phonemes."""
    return any(kind_of(name) == "phoneme" for name in tiers)


def labels_in(content: bytes | None, file: LabelFile, sound_s: float | None = None) -> Labels:
    """Return the labels in a label file. Raises LabelError, with the file's name.

    content: the file's bytes; None: they are read from the path in `file`. sound_s: length of the
    sound in s, with which the labels' times are compared; None: not known.
    """
    try:
        text = read_text(file.path) if content is None else decode_labels(content)
        tiers = tiers_in(text, file.alphabet)
        tier = _choose_tier(tiers, file.tier)
        untimed = [shown(word) for each in tiers for word in each.untimed]
        notes = [f"word {word} has no time; it is passed over" for word in untimed]
        if tier.kind == "word":
            labels = Labels((), tuple(unit for unit in tier.units if unit.label))
            spoken_s = [unit.start_s for unit in labels.words]
        else:
            labels = _phones(tier, file.alphabet)
            spoken_s = [e.end_s or 0.0 for e in labels.phones if e.phoneme != SILENCE]
        if not spoken_s:
            raise LabelError("all labels are silence, or times are not in seconds; correct it")
        if sound_s is not None:
            labelled_s = max(*spoken_s, *(unit.end_s or 0.0 for unit in tier.units))
            notes += _check_times(max(spoken_s), labelled_s, sound_s)
    except (LabelError, VendorError) as error:
        raise LabelError(f"{str(file.path)[:200]}: {error}") from None
    return replace(labels, notes=(*notes, *labels.notes))


def sound_beside(path: Path) -> Path:
    """Return the sound file beside `path` that has the same name but for the ending, such as .wav.

    Raises LabelError if there is none.
    """
    for ending in _SOUND_ENDINGS:
        if os.path.isfile(sound := f"{path.parent / path.stem}{ending}"):
            return Path(sound)
    raise LabelError(
        f"{str(path)[:200]}: no sound beside it; put it there as {path.stem[:100]} with "
        f"{', '.join(_SOUND_ENDINGS)}, or give both to `lipservo run --wav SOUND --phonemes FILE`"
    )


def _choose_tier(tiers: Sequence[Tier], wanted: str) -> Tier:
    """Return the tier called `wanted`; "": that of the phonemes, else of visemes, else of words.

    A single tier of unknown kind is of words or phonemes if `wanted` says `words` or `phones`.
    Raises LabelError where no tier or several remain.
    """
    names = ", ".join(tier.name for tier in tiers)[:200]
    by_name = {tier.name: tier for tier in tiers if not wanted or tier.name == wanted}
    if len(tiers) == 1 and not tiers[0].kind and wanted in ("words", "phones"):
        return replace(tiers[0], kind="word" if wanted == "words" else "phoneme")
    for kind in ("phoneme", "viseme", "", "word"):
        of_kind = [tier for tier in by_name.values() if tier.kind == kind and tier.units]
        if len(of_kind) == 1 and (kind or wanted or len(tiers) == 1):
            return of_kind[0]
        if of_kind:
            break
    if not tiers:
        raise LabelError("the file has no tier of intervals; save labels with a start and an end")
    if wanted and not by_name:
        raise LabelError(f"the file has no tier {shown(wanted)}, but {names}; give --tier NAME")
    raise LabelError(f"the file has several tiers: {names}; choose one with --tier NAME")


def _phones(tier: Tier, named_alphabet: str) -> Labels:
    """Return a tier's phonemes or visemes as events; phones of one unit share its time evenly.

    named_alphabet: the one that the user names, or "". Raises LabelError for an overlap and for a
    label that is not in the alphabet.
    """
    units, n_no_length = _join_edges(tier)
    alphabet = named_alphabet or tier.alphabet or alphabet_of(tier.units)
    events: list[PhonemeEvent] = []
    for unit in units:
        end_s = unit.start_s + _LAST_PHONEME_S if unit.end_s is None else unit.end_s
        try:
            phones = phones_of(unit.label, alphabet, guesses=False)
        except AlphabetError as error:
            raise LabelError(f"{_where(tier, unit)}: {error}") from None
        _append_phone(events, SILENCE, events[-1].end_s or 0.0 if events else 0.0, unit.start_s)
        # A mark of length or a space has no phones: the phoneme before it continues.
        phones_in_turn = phones or (events[-1].phoneme if events else SILENCE,)
        share_s = (end_s - unit.start_s) / len(phones_in_turn)
        bounds_s = [unit.start_s + n * share_s for n in range(len(phones_in_turn))] + [end_s]
        for phone, (start_s, stop_s) in zip(phones_in_turn, pairwise(bounds_s), strict=True):
            _append_phone(events, phone, start_s, stop_s, extends=not phones)
    if units and units[-1].end_s is None and events and events[-1].phoneme == SILENCE:
        del events[-1]
    n_unspelt = sum(each.label.lower() in UNSPELT for each in units)
    counts = {
        "labels without length, left out": n_no_length,
        "stretches not spelt by the aligner, where the mouth rests": n_unspelt,
    }
    return Labels(tuple(events), (), tuple(f"{what}: {n}" for what, n in counts.items() if n))


def _join_edges(tier: Tier) -> tuple[list[TimedUnit], int]:
    """Return a tier's units, edges within 1 ms joined, and the number of labels without length.

    A unit without an end ends where the next one begins. Raises LabelError for an overlap.
    """
    joined: list[TimedUnit] = []
    n_no_length = 0
    for unit, next_unit in zip(tier.units, (*tier.units[1:], None), strict=True):
        if unit.end_s is None and next_unit is not None:
            unit = unit._replace(end_s=next_unit.start_s)
        if unit.end_s is not None and unit.end_s - unit.start_s < _EDGE_S:
            n_no_length += bool(unit.label)
            continue
        reached_s = (joined[-1].end_s or 0.0) if joined else 0.0
        if joined and unit.start_s < reached_s - _EDGE_S:
            raise LabelError(
                f"{_where(tier, joined[-1])}: {shown(joined[-1].label)} ends at {reached_s:.3f} s, "
                f"but {shown(unit.label)} begins at {unit.start_s:.3f} s; remove the overlap"
            )
        if abs(unit.start_s - reached_s) < _EDGE_S:
            unit = unit._replace(start_s=reached_s)
        joined.append(unit)
    return joined, n_no_length


def _where(tier: Tier, unit: TimedUnit) -> str:
    """Return for a message where a unit is: tier, number of the label, time."""
    number = next(n for n, each in enumerate(tier.units, 1) if each.start_s >= unit.start_s)
    return f"tier {shown(tier.name)}, {tier.kind or 'label'} {number} at {unit.start_s:.3f} s"


def _check_times(spoken_s: float, reached_s: float, sound_s: float) -> list[str]:
    """Return a note if labels end long before the sound, else []; times in s.

    spoken_s: end of the last label that is not silence (start of the last word); reached_s: end of
    all labels; sound_s: length of the sound. Raises LabelError if `spoken_s` is after the sound.
    """
    if spoken_s > sound_s + _AFTER_SOUND_S:
        raise LabelError(
            f"the last label ends at {spoken_s:.3f} s, but the sound is {sound_s:.3f} s long; give "
            "the labels of this sound, with times in seconds"
        )
    note = (
        f"its labels end at {reached_s:.3f} s, and the sound is {sound_s:.3f} s long; is the file "
        "cut off, or that of another sound?"
    )
    return [note] if sound_s - reached_s > max(0.3, _UNLABELLED * sound_s) else []


def _append_phone(
    events: list[PhonemeEvent], phone: str, start_s: float, end_s: float, *, extends: bool = False
) -> None:
    """Append `phone` from `start_s` to `end_s` to the events, unless it has no length.

    Silence, or any phone if `extends`, extends a last event of the same phone instead.
    """
    if end_s <= start_s:
        return
    if events and events[-1].phoneme == phone and (extends or phone == SILENCE):
        events[-1] = replace(events[-1], end_s=end_s)
    else:
        events.append(PhonemeEvent(phone, start_s, end_s))
