"""The options of a robot that speaks, as a run needs them."""

from dataclasses import replace
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
    voice: VoiceOptions | None, listen: str | None, agents: VoiceOptions
) -> VoiceOptions | None:
    """The voice of a face that voice agents speak through, unless it listens nowhere.

    agents: what was typed for them.
    """
    if listen == "none":
        if agents != VoiceOptions():
            raise typer.BadParameter("--listen none: nobody is there for the options of agents")
        return voice
    return replace(agents, output=None if voice is None else voice.output)


def text_of(path: Path | None) -> str | None:
    """A path as a request carries it."""
    return None if path is None else str(path)
