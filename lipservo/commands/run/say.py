"""The command `say`, which speaks a text with sound and face."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lipservo.access.token_file import read_token
from lipservo.commands import options
from lipservo.commands.run.motion_choice import takes_motion
from lipservo.commands.run.run import avatars_of, labelled_sound, motion_of, run_once
from lipservo.runtime.motion_options import ChosenMotion
from lipservo.runtime.run_request import (
    DEFAULT_OUTPUT,
    RunRequest,
    Sound,
    VoiceOptions,
)
from lipservo.terminal.output import RESULTS, print_json
from lipsync.errors import UserError
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
    context: typer.Context,
    text: Annotated[str | None, typer.Argument(help="Text to say.")] = None,
    from_file: Annotated[
        Path | None,
        typer.Option(
            "--from",
            help="Label file to say: words, phonemes or visemes with times (docs/text.md); the "
            "sound file of the same name must be beside it.",
        ),
    ] = None,
    tier: options.Tier = "",
    alphabet: options.Alphabet = "",
    channel: options.Channel = "",
    language: Language = None,
    voice: SpokenBy = None,
    rate_wpm: RateWpm = None,
    pitch: Pitch = None,
    mute: Annotated[bool, typer.Option("--mute", help="Move the mouth without sound.")] = False,
    through: options.Through = None,
    token_file: options.TokenFile = None,  # noqa: ARG001
    output: options.Output = None,
    config: options.Config = options.DEFAULT_FACE,
    model: options.Model = None,
    osc: options.Osc = None,
    live_link: options.LiveLink = None,
    trace: options.Trace = None,
    rate_hz: options.Rate = None,
    motion: ChosenMotion,
    port: options.Port = None,
    sim: options.Sim = None,
    dry_run: options.DryRun = False,
    as_json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Speak a text with sound and face, by the voice in the face's YAML; or speak a label file."""
    if through is not None and text is not None:
        given = {"language": language, "voice": voice, "rate_wpm": rate_wpm, "pitch": pitch}
        how = {name: value for name, value in given.items() if value is not None}
        speak_through(context, {"text", *given}, lambda face: face.say(text, wait=True, **how))
        return
    if mute and output is not None:
        raise typer.BadParameter("give --mute or --output, not both")
    labels = options.label_file(from_file, tier, alphabet)
    if labels is not None and text is None and through is None:
        from lipsync.phoneme_files.reader import sound_beside

        sound = replace(labelled_sound(sound_beside(labels.path), labels), channel=channel)
    elif from_file is not None or text is None:
        raise typer.BadParameter("give a text or --from FILE, not both; --through needs a text")
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


def speak_through(
    context: typer.Context, obeyed: set[str], tell: "Callable[[Face], dict[str, Any]]"
) -> None:
    """Call `tell` with a client of the running face at --through; print how much was played.

    context: of the command. obeyed: names of its parameters that the running face can obey. tell:
    lets the face speak, and returns `finished` and `played_s`. Raises BadParameter, before anything
    is sent, for other options that were typed; UserError also unless all was played.
    """
    from lipservo_client.blocking_face import Face
    from lipservo_client.protocol import FaceError

    from firmware_bridge.process.control_client import printable

    obeyed = obeyed | {"through", "token_file", "as_json", "quiet"}
    typed = [
        each.opts[0]
        for each in context.command.params
        if each.name not in obeyed
        and getattr(context.get_parameter_source(each.name or ""), "name", "") == "COMMANDLINE"
    ]
    if typed:
        raise typer.BadParameter(
            f"{', '.join(typed)}: not with --through, since the face that runs has its own servos, "
            "sound and settings; leave out the one or the other"
        )
    given = context.params
    url, token = given["through"], given["token_file"]
    try:
        with Face(url, read_token(token and str(token))) as face:
            played = tell(face)
    except KeyboardInterrupt:
        raise UserError("not waited for any more; the face may go on: `lipservo stop`") from None
    except FaceError as error:
        raise UserError(f"--through {url}: {printable(str(error))}") from error
    if given["as_json"]:
        print_json(played)
    if not played["finished"]:
        raise UserError(
            f"--through {url}: not played to its end, only {played['played_s']:.1f} s of it; "
            "`lipservo status` shows the face"
        )
    if not (given["as_json"] or given["quiet"]):
        RESULTS.print(f"played to its end: {played['played_s']:.1f} s")
