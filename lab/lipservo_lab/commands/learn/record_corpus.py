"""`record-corpus`: a person is recorded while reading sentences, for `import-video`."""

import signal
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lipservo.commands.options import Json, Quiet
from lipservo.terminal.output import MESSAGES, RESULTS, print_json
from lipsync.output_file import OutputError

if TYPE_CHECKING:
    from lipservo.calibrating.camera import CameraMode


def record_corpus(
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", help="Folder to record into; sentences recorded there are skipped."
        ),
    ] = None,
    sentences: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Text file of your own sentences, one a line; default: 60 shipped ones.",
        ),
    ] = None,
    camera: Annotated[
        str,
        typer.Option(
            metavar="DEVICE",
            help="Camera: a number or device path; or a video file or lavfi:GRAPH, for a trial.",
        ),
    ] = "0",
    size: Annotated[str, typer.Option(metavar="WxH", help="Picture size to request.")] = "1280x720",
    rate_hz: Annotated[
        float, typer.Option("--rate", min=24.0, max=120.0, help="Pictures per second to request.")
    ] = 30.0,
    mic: Annotated[
        str | None,
        typer.Option(
            metavar="DEVICE", help="Microphone: a number or part of a name; default: the system's."
        ),
    ] = None,
    list_: Annotated[bool, typer.Option("--list", help="Print the sentences and end.")] = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Record yourself reading sentences, with camera and microphone.

    Each sentence becomes NAME.mkv, NAME.wav and NAME.txt, for `lipservo learn import-video`
    (docs/own-face.md, "Record yourself"). Space starts and ends a recording; no incomplete
    recording is kept.
    """
    from lipservo_lab.recording.sentence_list import (
        read_sentences,
        recorded_names,
        shipped_sentences,
    )

    sentence_list = shipped_sentences() if sentences is None else read_sentences(sentences)
    if list_:
        if as_json:
            print_json({"sentences": {s.name: s.text for s in sentence_list}})
            return
        for sentence in sentence_list:
            RESULTS.print(f"{sentence.name}  {sentence.text}", soft_wrap=True)
        return
    if output is None:
        raise typer.BadParameter("name a folder to record into", param_hint="--output")
    mode = _mode(size, rate_hz)
    _check_folder(output)
    recorded = recorded_names(output, sentence_list)
    n_before = len(recorded)
    if n_before:
        MESSAGES.print(
            f"{output}: {n_before} of {len(sentence_list)} sentences are there already",
            soft_wrap=True,
        )
    from firmware_bridge.stop_signals import SignalCounter
    from lipservo.calibrating.camera import AvCamera, CameraFeed
    from lipservo.terminal.keys import PressedKeys
    from lipservo_lab.recording.session import Devices, Screen, Session
    from lipsync.audio.microphone import MicrophoneSource

    feed = CameraFeed(AvCamera(camera, mode))
    microphone = MicrophoneSource(mic)
    screen = Screen(quiet=quiet)
    with SignalCounter() as signals, microphone, feed, PressedKeys() as keys:
        devices = Devices(
            microphone,
            feed,
            feed.camera.rate_hz,
            lambda timeout_s: keys.next_key(timeout_s, signals),
            lambda: signals.count > 0,
            time.monotonic,
            time.sleep,
        )
        try:
            outcome = Session(devices, screen, output).run(sentence_list, recorded)
        finally:
            screen.end()
    complete = recorded_names(output, sentence_list)
    if as_json:
        print_json(
            {
                "folder": str(output),
                "recorded": outcome.recorded,
                "skipped": outcome.skipped,
                "warnings": outcome.warnings,
                "there": len(complete),
                "missing": [s.name for s in sentence_list if s.name not in complete],
            }
        )
    else:
        RESULTS.print(
            f"{output}: {len(complete)} of {len(sentence_list)} sentences recorded; "
            + (
                f"`lipservo learn import-video {output} -o CORPUS` goes on"
                if len(complete) == len(sentence_list)
                else "the same command goes on with the rest"
            ),
            soft_wrap=True,
        )
    if signals.count:
        raise typer.Exit(128 + signal.Signals[signals.last].value)


def _mode(size: str, rate_hz: float) -> "CameraMode":
    """Return the camera mode of an option WIDTHxHEIGHT; raises BadParameter for anything else."""
    from lipservo.calibrating.camera import CameraMode

    width, _, height = size.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal() and 0 < int(width) < 10_000 > int(height) > 0):
        raise typer.BadParameter(
            f"{size!r}: write WIDTHxHEIGHT, such as 1280x720", param_hint="--size"
        )
    return CameraMode(int(width), int(height), rate_hz)


def _check_folder(folder: Path) -> None:
    """Make the folder if it does not exist. Raises OutputError."""
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"{folder}: is a file; name a folder to record into")
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        reason = error.strerror if folder.parent.is_dir() else f"there is no folder {folder.parent}"
        raise OutputError(f"{folder}: cannot be made: {reason}") from error
