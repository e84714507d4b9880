"""The command `say`, which speaks a text with sound and face."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lipservo.access.token_file import read_token
from lipservo.commands.options import (
    DEFAULT_FACE,
    Alphabet,
    Channel,
    Config,
    DryRun,
    Json,
    LiveLink,
    Model,
    Osc,
    Output,
    Port,
    Quiet,
    Rate,
    Sim,
    Through,
    Tier,
    TokenFile,
    Trace,
    label_file,
)
from lipservo.commands.run.motion_choice import takes_motion
from lipservo.commands.run.run import avatars_of, labelled_sound, motion_of, run_once
from lipservo.runtime.motion_options import ChosenMotion
from lipservo.runtime.run_request import (
    DEFAULT_OUTPUT,
    RunRequest,
    Sound,
    VoiceOptions,
)
from lipsync.errors import UserError
from lipsync.phoneme_files.label_file import LabelFile
from lipsync.text_to_speech.synthesis import FASTEST_WPM, HIGHEST_PITCH, SLOWEST_WPM

if TYPE_CHECKING:
    from lipservo_client.blocking_face import Face


Language = Annotated[
    str | None, typer.Option(help="Language as espeak-ng names it: en-us, de, fr-fr.")
]
SpokenBy = Annotated[
    str | None, typer.Option(help="Voice of the face's speech synthesiser, by name.")
]
RateWpm = Annotated[
    int | None,
    typer.Option(
        min=SLOWEST_WPM, max=FASTEST_WPM, help="Speed of speech, words per minute; 175 is usual."
    ),
]
Pitch = Annotated[
    int | None,
    typer.Option(min=0, max=HIGHEST_PITCH, help="Pitch of the voice; 50 is the voice's own."),
]


@takes_motion
def say(
    *,
    text: Annotated[str | None, typer.Argument(help="Text to say.")] = None,
    from_file: Annotated[
        Path | None,
        typer.Option(
            "--from",
            help="Label file to say: words, phonemes or visemes with times (docs/text.md); the "
            "sound file of the same name must be beside it.",
        ),
    ] = None,
    tier: Tier = "",
    alphabet: Alphabet = "",
    channel: Channel = "",
    language: Language = None,
    voice: SpokenBy = None,
    rate_wpm: RateWpm = None,
    pitch: Pitch = None,
    mute: Annotated[bool, typer.Option("--mute", help="Move the mouth without sound.")] = False,
    through: Through = None,
    token_file: TokenFile = None,
    output: Output = None,
    config: Config = DEFAULT_FACE,
    model: Model = None,
    osc: Osc = None,
    live_link: LiveLink = None,
    trace: Trace = None,
    rate_hz: Rate = None,
    motion: ChosenMotion,
    port: Port = None,
    sim: Sim = None,
    dry_run: DryRun = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Speak a text with sound and face, by the voice in the face's YAML; or speak a label file."""
    if mute and output is not None:
        raise typer.BadParameter("give --mute or --output, not both")
    labels = label_file(from_file, tier, alphabet)
    if labels is not None and text is None and through is None:
        sound = replace(_text_in(labels), channel=channel)
    elif from_file is not None or text is None:
        raise typer.BadParameter("give a text or --from FILE, not both; --through needs a text")
    elif through is not None:
        given = {"language": language, "voice": voice, "rate_wpm": rate_wpm, "pitch": pitch}
        how = {name: value for name, value in given.items() if value is not None}
        read_through(through, token_file, lambda face: face.say(text, wait=True, **how))
        return
    else:
        sound = Sound("text", text, language or "", voice=voice, rate_wpm=rate_wpm, pitch=pitch)
    request = RunRequest(
        config,
        sound,
        motion_of(motion, config),
        model=model,
        port=port,
        rate_hz=rate_hz,
        trace=trace,
        as_json=as_json,
        quiet=quiet or as_json,
        dry_run=dry_run,
        voice=VoiceOptions(None if mute else output or DEFAULT_OUTPUT),
        avatars=avatars_of(config, osc, live_link),
    )
    run_once(request, sim)


def _text_in(labels: LabelFile) -> Sound:
    """Return the sound file next to `labels`, with these. Raises LabelError."""
    from lipsync.phoneme_files.reader import sound_beside

    return labelled_sound(sound_beside(labels.path), labels)


def read_through(
    url: str, token_file: Path | None, tell: "Callable[[Face], dict[str, Any]]"
) -> dict[str, Any]:
    """Return the result of `tell`, called with a client of the running face at `url`.

    token_file: has the face's token; None: no token is sent. Raises UserError.
    """
    from lipservo_client.blocking_face import Face
    from lipservo_client.protocol import FaceError

    from firmware_bridge.process.control_client import printable

    token = read_token(None if token_file is None else str(token_file))
    try:
        with Face(url, token) as face:
            return tell(face)
    except FaceError as error:
        raise UserError(f"--through {url}: {printable(str(error))}") from error
