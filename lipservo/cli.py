"""All commands of `lipservo`: the function of each, and its line in the help."""

import logging
import os
import sys
from importlib.metadata import version
from types import MappingProxyType
from typing import Annotated

import typer

from firmware_bridge.process import logs
from lipservo.commands.lazy_group import Command, LazyGroup

_RUN, _BUILD = "lipservo.commands.run", "lipservo.commands.build"
_SPEAK, _ROBOT, _LINES = "Run a face", "Set up a robot", "Scripted lines"
_WATCH, _LAB = "Watch and look after", "Measure and learn (lipservo-lab)"

COMMANDS = MappingProxyType(
    {
        "run": Command(f"{_RUN}.run:run", "Speech drives the face, live.", _SPEAK),
        "daemon": Command(f"{_RUN}.run:daemon", "Run until stopped, as a service.", _SPEAK),
        "say": Command(f"{_RUN}.say:say", "Speak a text, with sound and the face.", _SPEAK),
        "wyoming": Command(
            f"{_RUN}.wyoming:wyoming", "Let Home Assistant speak through a face.", _SPEAK
        ),
        "stop": Command(f"{_RUN}.stop:stop", "Stop every running face: to rest and limp.", _SPEAK),
        "start": Command(f"{_RUN}.stop:start", "Drive a stopped face again.", _SPEAK),
        "limp": Command(f"{_RUN}.stop:limp", "Switch torque off at once.", _SPEAK),
        "status": Command(f"{_RUN}.stop:status", "List the running faces.", _SPEAK),
        "set": Command(
            f"{_RUN}.set_value:set_value", "Change a setting of a running face.", _SPEAK, True
        ),
        "new-face": Command(f"{_BUILD}.builder:new_face", "Write the YAML of a face.", _ROBOT),
        "setup-servos": Command(
            f"{_BUILD}.setup_servos:setup_servos", "Give new servos their ids and limits.", _ROBOT
        ),
        "doctor": Command(f"{_BUILD}.doctor:doctor", "Check the port and its servos.", _ROBOT),
        "jog": Command(f"{_BUILD}.jogging:jog", "Move one joint.", _ROBOT, True),
        "servo": Command(f"{_RUN}.servo:servo", "Switch one servo off or on.", _ROBOT),
        "calibrate": Command(
            "lipservo.commands.calibrate.app:app", "Teach the robot a speaker's mouth.", _ROBOT
        ),
        "devices": Command(f"{_RUN}.devices:devices", "List microphones and loudspeakers.", _ROBOT),
        "sim-bus": Command(f"{_BUILD}.sim_bus:sim_bus", "Simulate servos behind a port.", _ROBOT),
        "lines": Command(
            "lipservo.commands.lines.app:app", "Render, play and align scripted lines.", _LINES
        ),
        "replay": Command(f"{_RUN}.run:replay", "Compute motion faster than real time.", _LINES),
        "export": Command(f"{_RUN}.export:export", "Write mouth shapes for avatars.", _LINES),
        "film": Command(f"{_RUN}.film:film", "Film a face that speaks, with sound.", _LINES),
        "dashboard": Command(f"{_RUN}.dashboard:dashboard", "Show a face in a browser.", _WATCH),
        "health": Command(f"{_RUN}.health:health", "Show the servos' log.", _WATCH),
        "trace": Command(f"{_RUN}.trace:app", "Compare recorded runs.", _WATCH),
        "bench": Command("", "Measure what the documentation claims.", _LAB),
        "learn": Command("", "Learn models from recordings.", _LAB),
        "study": Command("", "Ask people which mouth looks right.", _LAB),
        "builder-process": Command(
            f"{_BUILD}.builder_process:builder_process",
            "One step of the first hour; started by new-face --page.",
            hidden=True,
        ),
        "bridge-process": Command(
            f"{_RUN}.processes:bridge_process", "Own the port; started by daemon.", hidden=True
        ),
        "speech-process": Command(
            f"{_RUN}.processes:speech_process", "Hear and publish; started by daemon.", hidden=True
        ),
    }
)
#: What an old name is now.
MOVED = MappingProxyType(
    {
        "train": "learn face",
        "train-recognizer": "learn recognizer",
        "train-offline": "learn offline",
        "adapt": "learn adapt",
        "import-video": "learn import-video",
        "import-scans": "learn import-scans",
        "record-corpus": "learn record",
        "plot-training": "learn plot",
        "render": "lines render",
        "perform": "lines perform",
        "align": "lines align",
        "recognize": "lines recognize",
        "calibrate-audio": "calibrate audio",
        "neutral": "calibrate neutral",
        "trim": "calibrate trim",
    }
)


class LipservoGroup(LazyGroup):
    """The commands of `lipservo` at the top level, and the new names of moved ones."""

    table = COMMANDS
    moved = MOVED


app = typer.Typer(name="lipservo", cls=LipservoGroup, pretty_exceptions_enable=False)


@app.callback(invoke_without_command=True)
def lipservo(
    context: typer.Context,
    show_version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.")
    ] = False,
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", help="Log in detail, with the name of each logger.")
    ] = False,
    log_json: Annotated[
        bool, typer.Option("--log-json", help="Log JSON lines on stderr; show no live view.")
    ] = False,
) -> None:
    """Live speech, in English, moves a physical mouth."""
    for name, given in ((logs.VERBOSE, verbose), (logs.LOG_JSON, log_json)):
        if given:
            os.environ[name] = "1"  # for the processes of a face, too
    # What happens to the simulated servos of a bench is what it measures.
    logs.set_up(logging.ERROR if context.invoked_subcommand == "bench" else logging.WARNING)
    if show_version:
        sys.stdout.write(f"lipservo {version('lipservo')}\n")
        raise typer.Exit
    if context.invoked_subcommand is None:
        raise typer.BadParameter("no command given; --help lists them")
