"""`run`, `daemon` and `replay`: a sound drives a face live, until stopped, or faster than live."""

import socket
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from firmware_bridge.clock import ManualClock, MonotonicClock
from lipservo.commands.options import (
    DEFAULT_FACE,
    Alphabet,
    Channel,
    Config,
    Control,
    Dashboard,
    DashboardListen,
    DryRun,
    Json,
    Listen,
    Mic,
    Model,
    OpenPage,
    OpenToThisComputer,
    Osc,
    Phonemes,
    Play,
    Port,
    Quiet,
    Rate,
    Sim,
    Sounds,
    SpokenText,
    Tier,
    TokenFile,
    Trace,
    Wav,
    label_file,
)
from lipservo.commands.run.dashboard_beside import check_page_options, dashboard_beside, with_sounds
from lipservo.commands.run.motion_choice import takes_motion
from lipservo.commands.run.voice_choice import (
    access_file,
    chosen_voice,
    daemons_voice,
    spoken_text,
    text_of,
    with_access,
)
from lipservo.runtime.face_runtime import RunOutcome, run_face
from lipservo.runtime.motion_options import ChosenMotion, MotionOptions, motion_options
from lipservo.runtime.run_request import (
    CLIP,
    SILENCE,
    AvatarTargets,
    RunRequest,
    Sound,
    VoiceOptions,
)
from lipservo.runtime.servos.assembly import load_settings
from lipservo.runtime.servos.face_stopped import exit_status
from lipservo.runtime.servos.sim_process import servo_port
from lipservo.runtime.sound import entered_sound
from lipservo.runtime.summary import print_summary
from lipservo.terminal.output import MESSAGES, RESULTS, print_json
from lipsync.phoneme_files.label_file import LabelFile

#: For a face's own page: it asks the face where that is.
ANY_PORT = "127.0.0.1:0"


def run(
    *,
    wav: Wav = None,
    mic: Mic = None,
    channel: Channel = "",
    play: Play = None,
    phonemes: Phonemes = None,
    tier: Tier = "",
    alphabet: Alphabet = "",
    text: SpokenText = "",
    config: Config = DEFAULT_FACE,
    model: Model = None,
    osc: Osc = None,
    trace: Trace = None,
    port: Port = None,
    sim: Sim = None,
    dashboard: Dashboard = False,
    open_page: OpenPage = False,
    dry_run: DryRun = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Let speech drive a face live: a sound file or microphone, else the bundled clip.

    With --dashboard, in a terminal, the face runs until Ctrl-C. All other settings are in the
    face's YAML.
    """
    check_page_options(None, is_shown=dashboard, open_page=open_page)
    voice = chosen_voice(play, is_needed=phonemes is not None or dashboard)
    token_file = None
    if dashboard:
        token_file = access_file(None, open_to_this_computer=False)
        voice = with_access(with_sounds(voice), config, token_file)
    request = RunRequest(
        config,
        replace(
            _chosen_sound(wav, mic, CLIP, label_file(phonemes, tier, alphabet), spoken_text(text)),
            channel=channel,
        ),
        motion_of(ChosenMotion(), config),
        model=model,
        port=port,
        trace=trace,
        as_json=as_json,
        quiet=quiet or as_json,
        dry_run=dry_run,
        voice=voice,
        avatars=avatars_of(config, osc, None),
    )
    if not dashboard:
        run_once(request, sim)
        return
    from lipservo.agents.listener import bind_listener

    with (
        bind_listener(ANY_PORT, None) as agents,
        dashboard_beside(request, None, token_file, open_page=open_page),
    ):
        run_once(request, sim, agents, endless=MESSAGES.is_terminal)


def daemon(
    *,
    wav: Wav = None,
    mic: Mic = None,
    channel: Channel = "",
    play: Play = None,
    listen: Listen = None,
    token_file: TokenFile = None,
    open_to_this_computer: OpenToThisComputer = False,
    sounds: Sounds = None,
    config: Config = DEFAULT_FACE,
    model: Model = None,
    trace: Trace = None,
    port: Port = None,
    control: Control = None,
    dashboard: Dashboard = False,
    dashboard_listen: DashboardListen = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Run a face until it is stopped, as a service does; without any sound its mouth stays closed.

    With servos at a port, servo loop and speech are separate processes, which the daemon
    supervises.
    """
    check_page_options(dashboard_listen, is_shown=dashboard, open_page=False)
    voice = daemons_voice(
        chosen_voice(play),
        listen,
        VoiceOptions(None, None if dashboard else text_of(token_file), text_of(sounds)),
    )
    if listen != "none" or dashboard:
        token_file = access_file(token_file, open_to_this_computer=open_to_this_computer)
    if voice is not None:
        voice = with_access(voice, config, token_file)
    settings = load_settings(config)[0]
    request = RunRequest(
        config,
        replace(_chosen_sound(wav, mic, SILENCE), channel=channel),
        motion_of(ChosenMotion(), config),
        model=model,
        port=port or settings.servo_port,
        trace=trace,
        control=control,
        as_json=as_json,
        quiet=quiet,
        voice=with_sounds(voice) if dashboard and voice is not None else voice,
        avatars=avatars_of(config, None, None),
    )
    from lipservo.runtime.voice_agents import bound_listener

    with ExitStack() as stack:
        listener = bound_listener(listen, text_of(token_file))
        if listener is not None:
            stack.enter_context(listener)
        if dashboard:
            page = dashboard_beside(request, dashboard_listen, token_file, open_page=False)
            stack.enter_context(page)
        if request.port is not None:
            from lipservo.runtime.processes import supervise

            raise typer.Exit(supervise(request, listener))
        source = stack.enter_context(entered_sound(request))
        outcome = run_face(request, source, MonotonicClock(), endless=True, listener=listener)
    # A service manager counts anything but 0 as a failure, and stops a daemon by a signal.
    finish(request, replace(outcome, signal_number=None))


@takes_motion
def replay(
    *,
    sound: Annotated[Path, typer.Argument(help="Sound file to replay.")],
    text: SpokenText = "",
    channel: Channel = "",
    config: Config = DEFAULT_FACE,
    model: Model = None,
    trace: Trace = None,
    rate_hz: Rate = None,
    motion: ChosenMotion,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Compute the motion for a sound file as fast as possible, on a simulated clock.

    The same file gives the same trace.
    """
    request = RunRequest(
        config,
        Sound("file", str(sound), text=spoken_text(text), channel=channel),
        motion_of(motion, config),
        model=model,
        rate_hz=rate_hz,
        trace=trace,
        as_json=as_json,
        quiet=True,
    )
    with entered_sound(request) as source:
        outcome = run_face(request, source, ManualClock())
    finish(replace(request, quiet=quiet), outcome)


def run_once(
    request: RunRequest,
    sim: str | None,
    listener: socket.socket | None = None,
    *,
    endless: bool = False,
) -> None:
    """Play a request live to the end of its sound, print its result, and end with its exit status.

    sim: `pty`: the servos are simulated behind a port made for this run; None: they are not.
    listener: where voice agents connect; None: no agents are served; endless: the face goes on when
    the sound is over.
    """
    with servo_port(request.port, sim, request.config) as at_port, entered_sound(request) as source:
        request = replace(request, port=at_port)
        outcome = run_face(
            request,
            source,
            MonotonicClock(),
            live=not request.quiet,
            endless=endless,
            listener=listener,
        )
    finish(request, outcome)


def _chosen_sound(
    wav: Path | None,
    mic: str | None,
    otherwise: Sound,
    labels: LabelFile | None = None,
    text: str = "",
) -> Sound:
    """Return the sound that a command's options choose: a file, a microphone, else `otherwise`.

    labels, text: phones or words of the file. Raises BadParameter for options that exclude each
    other, and without the file that they need; RequestError for both labels and text.
    """
    if wav is not None and mic is not None:
        raise typer.BadParameter("give --wav or --mic, not both")
    if labels is not None and wav is None:
        raise typer.BadParameter("--phonemes needs --wav")
    if text and wav is None:
        raise typer.BadParameter("--text needs --wav")
    if mic is not None:
        return Sound("microphone", mic)
    if wav is None:
        return otherwise
    if labels is None:
        return Sound("file", str(wav), text=text)
    return labelled_sound(wav, labels, text)


def labelled_sound(sound: Path, labels: LabelFile, text: str = "") -> Sound:
    """Return a sound file with its labels. Raises RequestError for a text beside them."""
    return Sound("file", str(sound), "", str(labels.path), labels.tier, labels.alphabet, text)


def motion_of(chosen: ChosenMotion, config: str) -> MotionOptions:
    """Return the user's motion options, completed by the YAML of the face `config`."""
    settings, folder = load_settings(config)
    return motion_options(chosen, settings.motion, folder)


def avatars_of(config: str, osc: str | None, live_link: str | None) -> AvatarTargets:
    """Return the avatars' targets that the user gave, completed by the YAML of face `config`.

    osc, live_link: HOST or HOST:PORT for each protocol; None: not given.
    """
    written = load_settings(config)[0].avatars
    return AvatarTargets(osc or written.osc, live_link or written.live_link)


def finish(request: RunRequest, outcome: RunOutcome) -> None:
    """Print the result of a run. Raises typer.Exit with its exit status unless that is 0."""
    if request.as_json:
        status = outcome.status.as_dict()
        stop = outcome.report.as_dict()
        print_json({**outcome.summary.as_dict(), "status": status, "stop": stop})
    elif not request.quiet:
        print_summary(outcome.summary, RESULTS)
    heard, listens = outcome.summary, request.sound.kind in ("file", "microphone")
    if listens and heard.phonemes == 0 and heard.duration_s > 1.0:
        MESSAGES.print(
            f"{heard.source}: no speech was found in {heard.duration_s:.0f} s, so the mouth stayed "
            "at rest; check the file, --channel and level"
        )
    exit_code = exit_status(outcome.report, outcome.signal_number)
    if not outcome.report.complete and request.quiet:
        MESSAGES.print(outcome.report.text())
    if exit_code:
        raise typer.Exit(exit_code)
