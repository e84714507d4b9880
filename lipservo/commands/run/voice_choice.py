"""Options of a face's voice and of its servers, as a run request contains them."""

from dataclasses import replace
from pathlib import Path

import typer

from lipservo.access.token_file import read_token, runtime_token_file
from lipservo.runtime.run_request import VoiceOptions
from lipservo.runtime.servos.assembly import load_settings
from lipsync.errors import UserError
from lipsync.spoken_text import LONGEST_TEXT


def chosen_voice(play: str | None, *, is_needed: bool = False) -> VoiceOptions | None:
    """Return a voice that plays at the device `play`, a mute one if `is_needed`, else None."""
    return VoiceOptions(play) if play is not None or is_needed else None


def daemons_voice(
    voice: VoiceOptions | None, listen: str | None, agents: VoiceOptions
) -> VoiceOptions | None:
    """Return the voice that voice agents speak through, with the loudspeaker of `voice`.

    Without a listener (`listen` is `none`) it returns `voice`. agents: the options typed for
    agents; typer.BadParameter is raised for any without a listener.
    """
    if listen == "none":
        if agents != VoiceOptions():
            raise typer.BadParameter("with --listen none leave out --sounds and --token-file")
        return voice
    return replace(agents, output=None if voice is None else voice.output)


def access_file(token_file: Path | None, *, open_to_this_computer: bool) -> Path | None:
    """Return the file of the token that a face's servers require; None: none from local clients.

    token_file: given by the user; None: the runtime folder's. open_to_this_computer: local clients
    need no token. Raises UserError, ControlError, and typer.BadParameter if both options are given.
    """
    if token_file is None:
        return None if open_to_this_computer else runtime_token_file()
    if open_to_this_computer:
        raise typer.BadParameter("give --token-file or --open-to-this-computer, not both")
    read_token(str(token_file))
    return token_file


def with_access(voice: VoiceOptions, config: str, token_file: Path | None) -> VoiceOptions:
    """Return the voice with `token_file`, and with the origins and queue of the face's YAML."""
    access = load_settings(config)[0].access
    origins = ",".join(access.origins)
    return replace(voice, token_file=text_of(token_file), origins=origins, queue=access.queue)


def text_of(path: Path | None) -> str | None:
    """Return a path as text for a request; None for None."""
    return None if path is None else str(path)


def spoken_text(typed: str) -> str:
    """Return the text as typed, or for `@FILE` the content of that file. Raises UserError."""
    if not typed.startswith("@"):
        return typed
    path = Path(typed[1:])
    try:
        with path.open(encoding="utf-8") as file:
            text = file.read(LONGEST_TEXT + 1)
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8"
        raise UserError(f"{path}: cannot be read as text ({reason}); check the file") from None
    if len(text) > LONGEST_TEXT:
        raise UserError(f"{path}: longer than {LONGEST_TEXT} characters; give a shorter text")
    return text
