"""The options of a robot that speaks, as a run needs them."""

from pathlib import Path

import typer

from lipservo.street.voice_options import DEFAULT_OUTPUT, VoiceOptions


def chosen_voice(*, play: bool, output: str | None, is_needed: bool = False) -> VoiceOptions | None:
    """A voice if sound is to be played, or one is needed all the same."""
    if output is not None and not play:
        raise typer.BadParameter("--output goes with --play")
    if play:
        return VoiceOptions(output or DEFAULT_OUTPUT)
    return VoiceOptions() if is_needed else None


def agents_voice(
    voice: VoiceOptions | None, listen: str | None, token_file: Path | None
) -> VoiceOptions | None:
    """The same with an address where voice agents are waited for."""
    if listen is None:
        if token_file is not None:
            raise typer.BadParameter("--token-file goes with --listen HOST:PORT")
        return voice
    output = None if voice is None else voice.output
    return VoiceOptions(output, listen, None if token_file is None else str(token_file))
