"""`lines recognize`: the phonemes of a sound, printed with their times."""

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from lipservo.commands.options import EngineChoice, Json, WeightsChoice
from lipservo.terminal.output import MESSAGES
from lipsync.audio.source import AudioSource
from lipsync.recognition.weights import DEFAULT_WEIGHTS, check_weights


def recognize(
    sound: Annotated[Path | None, typer.Argument(help="Sound file.")] = None,
    mic: Annotated[
        str | None,
        typer.Option(metavar="[DEVICE]", help="Listen to a microphone.", show_default=False),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Write X.TextGrid or X.json at the end."),
    ] = None,
    engine: EngineChoice = "network",
    weights: WeightsChoice = DEFAULT_WEIGHTS,
    as_json: Json = False,
) -> None:
    """Print the phonemes of a sound file, or of a microphone as they are spoken, with their times.

    With --json one object a line: phoneme, start_s, end_s.
    """
    if (sound is None) == (mic is None):
        raise typer.BadParameter("give a sound file or --mic")
    from lipservo.street.phone_file import check_phone_file, write_phone_file
    from lipservo.street.settled_phonemes import settled_events
    from lipservo.street.sources import DEFAULT_MICROPHONE, open_microphone
    from lipservo.street.sources import warn as warn_of_sound
    from lipsync.audio.file import FileSource

    check_weights(weights)
    if output is not None:
        check_phone_file(output, inputs=[sound])
    source: AudioSource = (
        open_microphone(mic or DEFAULT_MICROPHONE)
        if sound is None
        else FileSource(sound, warn=warn_of_sound)
    )
    events = []

    def warn(line: str) -> None:
        MESSAGES.print(line, soft_wrap=True, markup=False, highlight=False)

    try:
        for event in settled_events(source, engine, weights, warn):
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
