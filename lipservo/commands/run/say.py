"""The command `say`, which speaks a text with sound and face."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lipservo.access.token_file import read_token
from lipservo.commands.options import (
    DEFAULT_FACE,
    Config,
    DryRun,
    Json,
    Language,
    LiveLink,
    Model,
    Osc,
    Output,
    Port,
    Quiet,
    Rate,
    Sim,
    Through,
    TokenFile,
    Trace,
)
from lipservo.commands.run.motion_choice import takes_motion
from lipservo.commands.run.run import avatars_of, motion_of, run_once
from lipservo.runtime.motion_options import ChosenMotion
from lipservo.runtime.run_request import (
    DEFAULT_OUTPUT,
    RunRequest,
    Sound,
    VoiceOptions,
)
from lipsync.errors import UserError

if TYPE_CHECKING:
    from lipservo_client.blocking_face import Face


@takes_motion
def say(
    *,
    text: Annotated[str | None, typer.Argument(help="What is said.", show_default=False)] = None,
    from_file: Annotated[
        Path | None,
        typer.Option(
            "--from",
            help="A synthesiser's file of words, phonemes or visemes, its sound beside it.",
            show_default=False,
        ),
    ] = None,
    language: Language = "en-us",
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
    """Speak a text with sound and face, by the voice of the face's YAML; or a file."""
    if mute and output is not None:
        raise typer.BadParameter("give --mute or --output, not both")
    if from_file is not None and text is None and through is None:
        sound = _text_in(from_file)
    elif from_file is not None or text is None:
        raise typer.BadParameter("give either a text or --from FILE; --through takes a text")
    elif through is not None:
        read_through(through, token_file, lambda face: face.say(text, wait=True))
        return
    else:
        sound = Sound("text", text, language)
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


def _text_in(path: Path) -> Sound:
    """Return the sound file next to `path`, with `path` as its phonemes. Raises LabelError."""
    from lipsync.phoneme_files.reader import sound_beside

    return Sound("file", str(sound_beside(path)), phonemes=str(path))


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
