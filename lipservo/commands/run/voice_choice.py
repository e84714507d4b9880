"""The options of a robot that speaks and of its servers, as a run needs them."""

from dataclasses import replace
from pathlib import Path

import typer

from lipservo.access.token_file import read_token, runtime_token_file
from lipservo.runtime.run_request import DEFAULT_OUTPUT, VoiceOptions
from lipservo.runtime.servos.assembly import load_settings
from lipsync.errors import UserError
from lipsync.spoken_text import LONGEST_TEXT


def chosen_voice(*, play: bool, is_needed: bool = False) -> VoiceOptions | None:
    """A voice if sound is to be played, or one is needed all the same."""
    if play:
        return VoiceOptions(DEFAULT_OUTPUT)
    return VoiceOptions() if is_needed else None


def daemons_voice(
    voice: VoiceOptions | None, listen: str | None, agents: VoiceOptions
) -> VoiceOptions | None:
    """The voice of a face that voice agents speak through, unless it listens nowhere.

    agents: what was typed for them.
    """
    if listen == "none":
        if agents != VoiceOptions():
            raise typer.BadParameter("--listen none: options of agents need a listener")
        return voice
    return replace(agents, output=None if voice is None else voice.output)


def access_file(token_file: Path | None, *, open_to_this_computer: bool) -> Path | None:
    """The file of the token that a face's servers ask for; None: open to this computer.

    Raises UserError, ControlError.
    """
    if token_file is None:
        return None if open_to_this_computer else runtime_token_file()
    if open_to_this_computer:
        raise typer.BadParameter("give --token-file or --open-to-this-computer, not both")
    read_token(str(token_file))
    return token_file


def with_access(voice: VoiceOptions, config: str, token_file: Path | None) -> VoiceOptions:
    """A voice whose agents need the token of that file, and what the face's YAML says of access."""
    access = load_settings(config)[0].access
    origins = ",".join(access.origins)
    return replace(voice, token_file=text_of(token_file), origins=origins, queue=access.queue)


def text_of(path: Path | None) -> str | None:
    """A path as a request carries it."""
    return None if path is None else str(path)


def spoken_text(typed: str) -> str:
    """What `--text` says: itself, or after an @ the content of a file. Raises UserError."""
    if not typed.startswith("@"):
        return typed
    path = Path(typed[1:])
    try:
        with path.open(encoding="utf-8") as file:
            text = file.read(LONGEST_TEXT + 1)
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8"
        raise UserError(f"{path}: cannot be read as a text ({reason}); name a file") from None
    if len(text) > LONGEST_TEXT:
        raise UserError(f"{path}: longer than {LONGEST_TEXT} characters; give a shorter text")
    return text
