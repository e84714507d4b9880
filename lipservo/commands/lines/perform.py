"""The command `lines perform`, which plays a rendered line, its sound and its motion together."""

from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from firmware_bridge.clock import MonotonicClock
from lipservo.agents.listener import bind_listener
from lipservo.commands import options
from lipservo.commands.run.dashboard_beside import check_page_options, dashboard_beside, with_sounds
from lipservo.commands.run.run import ANY_PORT, avatars_of, finish, motion_of
from lipservo.commands.run.say import speak_through
from lipservo.commands.run.voice_choice import access_file, with_access
from lipservo.runtime.face_runtime import run_face
from lipservo.runtime.motion_options import ChosenMotion, MotionOptions
from lipservo.runtime.run_request import DEFAULT_OUTPUT, SILENCE, RunRequest, VoiceOptions
from lipservo.runtime.servos.assembly import assemble_face
from lipservo.runtime.servos.sim_process import servo_port
from lipservo.runtime.sound import SpeechQueue, entered_sound, spoken_chunks
from lipservo.runtime.speech.performed_line import performed_line
from lipservo.terminal.output import MESSAGES
from lipsync.audio.playout import Playout
from lipsync.motion.still_motion import StillMotion
from lipsync.offline.performance import read_performance


def perform(
    *,
    context: typer.Context,
    performance: Annotated[
        Path,
        typer.Argument(
            help="Performance file (.perf), as `lines render` writes it; with --through its name "
            "in that face's folder of sounds."
        ),
    ],
    mute: Annotated[bool, typer.Option("--mute", help="Move the mouth without sound.")] = False,
    through: options.Through = None,
    output: options.Output = None,
    config: options.Config = options.DEFAULT_FACE,
    model: options.Model = None,
    osc: options.Osc = None,
    live_link: options.LiveLink = None,
    trace: options.Trace = None,
    rate_hz: options.Rate = None,
    port: options.Port = None,
    sim: options.Sim = None,
    dashboard: options.Dashboard = False,
    dashboard_listen: options.DashboardListen = None,
    token_file: options.TokenFile = None,
    open_to_this_computer: options.OpenToThisComputer = False,
    open_page: options.OpenPage = False,
    dry_run: options.DryRun = False,
    as_json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Play a performance file: its sound, and the motion that was rendered for it.

    The motion is played as rendered: no recogniser runs, and its amplitude is that of `lines render
    --strength`. With --dashboard, in a terminal, the face then continues until Ctrl-C, and listens
    and speaks like any other running face.
    """
    if through is not None:
        name = str(performance)
        speak_through(context, {"performance"}, lambda face: face.play(name, wait=True))
        return
    if mute and output is not None:
        raise typer.BadParameter("give --mute or --output, not both")
    check_page_options(
        dashboard_listen,
        is_shown=dashboard,
        open_page=open_page,
        token_file=token_file,
        open_to_this_computer=open_to_this_computer,
    )
    # All that can be wrong with the file is told before a device is opened.
    performed = read_performance(performance)
    face = assemble_face(config, model)
    performed.check_face(face.model, str(performance))
    line = performed_line(performed, performance)
    voice = VoiceOptions(None if mute else output or DEFAULT_OUTPUT)
    if dashboard:
        token_file = access_file(token_file, open_to_this_computer=open_to_this_computer)
        voice = with_access(with_sounds(voice), config, token_file)
    request = RunRequest(
        config,
        SILENCE,
        motion_of(ChosenMotion(), config)
        if dashboard
        else MotionOptions(performed=performed.method),
        model=model,
        port=port,
        rate_hz=rate_hz,
        trace=trace,
        as_json=as_json,
        quiet=quiet or as_json,
        dry_run=dry_run,
        voice=voice,
        avatars=avatars_of(config, osc, live_link),
    )
    with ExitStack() as stack:
        agents = None
        if dashboard:
            agents = stack.enter_context(bind_listener(ANY_PORT, None))
            page = dashboard_beside(request, dashboard_listen, token_file, open_page=open_page)
            stack.enter_context(page)
        request = replace(request, port=stack.enter_context(servo_port(port, sim, config)))
        playout = stack.enter_context(entered_sound(request))
        assert isinstance(playout, Playout)
        queue = stack.enter_context(closing(SpeechQueue(playout)))
        queue.add(spoken_chunks(line.chunks(), line.stream(playout), line.lasts_s), line.name)
        outcome = run_face(
            request,
            playout,
            MonotonicClock(),
            live=not request.quiet,
            endless=dashboard and MESSAGES.is_terminal,
            listener=agents,
            synthesizer=None if dashboard else StillMotion(face.model.rest),
        )
    finish(request, outcome)
