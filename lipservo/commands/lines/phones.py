"""`lines align` and `lines recognize`: the phonemes of a sound with their times, as labels."""

import json
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

from lipservo.commands.options import Channel, EngineChoice, Json, WeightsChoice
from lipservo.terminal.output import MESSAGES, RESULTS, print_json
from lipsync.audio.source import AudioSource
from lipsync.errors import UserError, check_extra, check_inputs
from lipsync.output_file import check_output, write_whole
from lipsync.recognition.network import DEFAULT_WEIGHTS, check_weights
from lipsync.textgrid import Interval, is_textgrid, write_tiers

Tiers = dict[str, tuple[Interval, ...]]

_TEXTGRID, _JSON = ".textgrid", ".json"


class PhoneFileError(UserError):
    """The error for a file name that ends neither in .TextGrid nor in .json; a one-line message."""


def check_phone_file(path: Path, inputs: Iterable[Path | None]) -> None:
    """Raise PhoneFileError unless `path` is .TextGrid or .json; OutputError if not writable.

    inputs: files that must not be overwritten.
    """
    if path.suffix.lower() == _TEXTGRID:
        check_output(path, replaces=is_textgrid, kind="TextGrid", inputs=inputs)
    elif path.suffix.lower() == _JSON:
        check_output(path, replaces=_is_tiers, kind="JSON of phones", inputs=inputs)
    else:
        raise PhoneFileError(f"{path}: this file type is unknown; use .TextGrid (Praat) or .json")


def write_phone_file(path: Path, tiers: Tiers) -> None:
    """Write tiers of labelled intervals, as a TextGrid or as JSON by the ending of `path`.

    The JSON: {"phones": [[label, start_s, end_s], ...], ...}, one entry a tier.
    """
    if path.suffix.lower() == _TEXTGRID:
        write_tiers(path, tiers)
    else:
        write_whole(path, json.dumps(tiers) + "\n")


def _is_tiers(head: bytes) -> bool:
    return head.startswith((b'{"phones": ', b'{"words": '))


def align(
    sound: Annotated[Path, typer.Argument(help="Sound file.")],
    text: Annotated[str, typer.Argument(help="The spoken text, or a text file that holds it.")],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Write X.TextGrid or X.json.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Find when each phone of a known text is spoken in a sound file.

    A text that is not spoken there is refused (docs/recognition.md, "Alignment").
    """
    if sound.is_dir():
        raise UserError(f"{sound}: is a folder; `lipservo lines align-folder` aligns its texts")
    check_inputs(sound)
    check_extra("pocketsphinx", "`lines align`")
    from lipservo.rendering.spoken_line import given_text
    from lipsync.audio.file import read_speech
    from lipsync.recognition.alignment import (
        DOUBTFUL_SCORE,
        LEAST_SCORE,
        USUAL_SCORES,
        AlignmentError,
        goodness_of_pronunciation,
    )
    from lipsync.recognition.alignment import align as force_align

    if output is not None:
        check_phone_file(output, inputs=[sound])
    samples = read_speech(sound)
    alignment = force_align(samples, given_text(text))
    score = goodness_of_pronunciation(samples, alignment.phones)
    if score < LEAST_SCORE:
        raise AlignmentError(
            f"{sound}: its speech is not this text (score {score:.2f}; spoken texts score above "
            f"{LEAST_SCORE}); check the text"
        )
    if score < DOUBTFUL_SCORE:
        MESSAGES.print(
            f"the text fits badly (score {score:.2f}, usual are {USUAL_SCORES}): words may be "
            "missing or too many, or the voice is hard to hear"
        )
    if alignment.guessed:
        MESSAGES.print(f"pronunciation of these words guessed: {', '.join(alignment.guessed)}")
    phones = tuple((e.phoneme, e.start_s, e.end_s or e.start_s) for e in alignment.phones)
    if output is not None:
        write_phone_file(output, {"words": alignment.words, "phones": phones})
    if as_json:
        print_json(
            {
                "phones": phones,
                "words": alignment.words,
                "score": round(score, 3),
                "beams": alignment.beams,
                "guessed": alignment.guessed,
            }
        )
    elif output is None:
        for phoneme, start_s, end_s in phones:
            RESULTS.print(f"{start_s:8.2f} {end_s:8.2f}  {phoneme}")


def recognize(
    sound: Annotated[Path | None, typer.Argument(help="Sound file.")] = None,
    mic: Annotated[
        str | None,
        typer.Option(metavar="[DEVICE]", help="Use a microphone: its number or part of its name."),
    ] = None,
    channel: Channel = "",
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Write X.TextGrid or X.json at the end.")
    ] = None,
    engine: EngineChoice = "network",
    weights: WeightsChoice = DEFAULT_WEIGHTS,
    as_json: Json = False,
) -> None:
    """Print the phonemes in a sound file, or live from a microphone, with their times in s.

    With --json each phoneme is one JSON object on a line: phoneme, start_s, end_s.
    """
    if (sound is None) == (mic is None):
        raise typer.BadParameter("give a sound file or --mic")
    from lipservo.runtime.run_request import DEFAULT_MICROPHONE
    from lipservo.runtime.settled_phonemes import settled_events
    from lipservo.runtime.sound import open_microphone
    from lipsync.audio.file import FileSource
    from lipsync.recognition.recognizers import make_recognizer

    check_weights(weights)
    if output is not None:
        check_phone_file(output, inputs=[sound])
    source: AudioSource = (
        open_microphone(mic or DEFAULT_MICROPHONE, channel)
        if sound is None
        else FileSource(sound, channel=channel)
    )
    recognizer = make_recognizer(engine, None if mic is None else time.perf_counter, weights)
    events = []
    try:
        for event in settled_events(source, recognizer):
            if output is not None:
                events.append(event)
            if as_json:
                record = {"phoneme": event.phoneme, "start_s": event.start_s, "end_s": event.end_s}
                sys.stdout.write(json.dumps(record) + "\n")
            elif output is None:
                sys.stdout.write(f"{event.start_s:8.2f} {event.end_s:8.2f}  {event.phoneme}\n")
            if mic is not None:
                sys.stdout.flush()
    except KeyboardInterrupt:
        MESSAGES.print("stopped")
    if output is not None:
        phones = tuple((e.phoneme, e.start_s, e.end_s or e.start_s) for e in events)
        write_phone_file(output, {"phones": phones})
