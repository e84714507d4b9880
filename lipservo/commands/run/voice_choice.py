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


def daemons_voice(
    voice: VoiceOptions | None, listen: str | None, token_file: Path | None, sounds: Path | None
) -> VoiceOptions | None:
    """The voice of a face that voice agents speak through, unless it listens nowhere."""
    if listen == "none":
        if token_file is not None or sounds is not None:
            raise typer.BadParameter("--listen none leaves nobody for --token-file and --sounds")
        return voice
    output = None if voice is None else voice.output
    return VoiceOptions(output, _text(token_file), _text(sounds))


def _text(path: Path | None) -> str | None:
    return None if path is None else str(path)
