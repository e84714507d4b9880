"""`calibrate audio`: measures a loudspeaker's delay beyond its own figure, for the face's YAML."""

import time
from pathlib import Path
from typing import Annotated

import typer

from lipservo.commands.options import DEFAULT_FACE, Config, Json
from lipservo.runtime.servos.assembly import load_settings
from lipservo.settings.edited_yaml import edited, lines_by_hand
from lipservo.terminal.output import MESSAGES, RESULTS, print_json


def calibrate_audio(
    config: Config = DEFAULT_FACE,
    output: Annotated[
        str | None,
        typer.Option(
            metavar="DEVICE",
            help="Loudspeaker: a number or part of a name (`lipservo devices`); default: the "
            "face's.",
        ),
    ] = None,
    from_input: Annotated[
        str | None,
        typer.Option(
            "--input",
            metavar="DEVICE",
            help="Microphone, or the loudspeaker's monitor input: a number or part of a name; "
            "default: the face's.",
        ),
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Measure, write nothing.")] = False,
    as_json: Json = False,
) -> None:
    """Measure how late a loudspeaker is, by clicks; write the offset into the face's YAML.

    Put the microphone about 10 cm in front of the loudspeaker. The command takes ten seconds.
    """
    from lipsync.audio.delay import measure_delay
    from lipsync.audio.loudspeaker import LoudspeakerOutput
    from lipsync.audio.microphone import MicrophoneSource

    settings, folder = load_settings(config)
    speaker = LoudspeakerOutput(output or settings.sound.output)
    microphone = MicrophoneSource(from_input or settings.sound.input)
    with microphone, speaker:
        found = measure_delay(speaker, microphone, time.monotonic, time.sleep)
        claimed_ms = 1e3 * speaker.claimed_latency_s
    offset_ms = round(1e3 * found.median_s, 1)
    path = None if folder is None or dry_run else Path(config)
    place = ("sound", "output_offset_ms", speaker.lasting_name)
    if path is not None:
        edited(path, {place: offset_ms}).write()
    if as_json:
        print_json(
            {
                "output": speaker.lasting_name,
                "input": microphone.name,
                "output_offset_ms": offset_ms,
                "spread_ms": round(1e3 * found.spread_s, 1),
                "claimed_latency_ms": round(claimed_ms, 1),
                "clicks_found": found.n_found,
                "clicks_played": found.n_played,
                "stored_in": None if path is None else str(path),
            }
        )
        return
    late = f"{abs(offset_ms):g} ms {'later' if offset_ms >= 0 else 'earlier'} than it says"
    RESULTS.print(
        f"{speaker.lasting_name}, heard by {microphone.name}: {found.n_found} of "
        f"{found.n_played} clicks\nsound leaves it {late}, give or take "
        f"{1e3 * found.spread_s:.1f}; it says {claimed_ms:.0f} ms after it was handed over",
    )
    if path is not None:
        RESULTS.print(f"written into {path}")
        return
    MESSAGES.print(f"not written; add to the face's YAML:\n{lines_by_hand(place, offset_ms)}")
