"""The command `lipservo`."""

import io
import sys
from importlib.metadata import version
from typing import Annotated

import typer

from firmware_bridge.bus import BusError
from firmware_bridge.runtime_folder import ControlError
from lipservo.commands import (
    alignment,
    bench,
    bench_closures,
    bench_recognition,
    bench_texts,
    builder,
    calibration,
    doctor,
    health,
    processes,
    recognition,
    setup_servos,
    sim_bus,
    stop,
    street,
    trace,
    training,
)
from lipservo.face_life import FaceStopped, exit_status
from lipservo.output import complain
from lipsync.errors import UserError

app = typer.Typer(name="lipservo", pretty_exceptions_enable=False)
for command in (
    street.run,
    street.daemon,
    street.replay,
    street.devices,
    training.train,
    calibration.calibrate,
    alignment.align,
    recognition.recognize,
    recognition.train_recognizer,
    recognition.plot_training,
):
    app.command()(command)
# Degrees may be negative, which looks like an option.
_DEGREES = {"ignore_unknown_options": True}
app.command("trim", context_settings=_DEGREES)(calibration.trim)
app.command("jog", context_settings=_DEGREES)(builder.jog)
bench.app.command("recognition")(bench_recognition.recognition)
bench.app.command("listening")(bench_recognition.listening)
bench.app.command("closures")(bench_closures.closures)
bench.app.command("texts")(bench_texts.texts)
app.command("sim-bus")(sim_bus.sim_bus)
app.command("doctor")(doctor.doctor)
app.command("neutral")(builder.neutral)
app.command("setup-servos")(setup_servos.setup_servos)
app.command("new-face")(builder.new_face)
app.command("bridge-process", hidden=True)(processes.bridge_process)
app.command("speech-process", hidden=True)(processes.speech_process)
app.command("stop")(stop.stop)
app.command("status")(stop.status)
app.command("limp")(stop.limp)
app.command()(health.health)
app.add_typer(bench.app, name="bench")
app.add_typer(trace.app, name="trace")


#: What pydantic says of a value, and what we say.
_IN_OUR_WORDS = {
    "Input should be a valid number, unable to parse string as a number": "not a number",
    "Input should be a valid integer, unable to parse string as an integer": "not a whole number",
    "Input should be ": "should be ",
    "Value error, ": "",
}


@app.callback(invoke_without_command=True)
def lipservo(
    context: typer.Context,
    show_version: Annotated[
        bool, typer.Option("--version", help="Print the version and leave.")
    ] = False,
) -> None:
    """Live speech, in English, moves a physical mouth."""
    if show_version:
        sys.stdout.write(f"lipservo {version('lipservo')}\n")
        raise typer.Exit
    if context.invoked_subcommand is None:
        raise typer.BadParameter("say which command")


def main() -> None:
    """Run the command line: status 0, 1 for what the user can mend, 2 for wrong usage.

    Every mistake is told in clear lines on stderr that begin with `lipservo:`.
    """
    for stream in (sys.stdin, sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # Names of files need not be UTF-8, and neither need a terminal be.
            stream.reconfigure(errors="backslashreplace")
    arguments = _with_default_microphone(sys.argv[1:] or ["--help"])
    try:
        status = app(arguments, prog_name="lipservo", standalone_mode=False)
    except typer.TyperException as error:
        complain(_usage_line(error))
        status = error.exit_code
    except (UserError, BusError, ControlError) as error:
        # Notes say what became of the servos.
        complain("\n".join([str(error), *getattr(error, "__notes__", [])]))
        status = 1
    except typer.Abort:
        complain("the input ended before all questions were answered; no file was written")
        status = 1
    except UnicodeDecodeError as error:
        complain(f"a file that should be text is none: byte {error.start} is no UTF-8")
        status = 1
    except OSError as error:
        where = "" if error.filename is None else f"{error.filename}: "
        complain(f"{where}{error.strerror or error}")
        status = 1
    except FaceStopped as stop:
        complain(str(stop))
        status = exit_status(stop.report, stop.signal_number)
    sys.exit(status or 0)


def _usage_line(error: typer.TyperException) -> str:
    """What is wrong with a command line, in one line, and where to read on."""
    told = " ".join(error.format_message().split())
    for pydantics, ours in _IN_OUR_WORDS.items():
        told = told.replace(pydantics, ours)
    context = getattr(error, "ctx", None)
    command = "lipservo" if context is None else context.command_path
    return f"{told.removeprefix('Invalid value: ').rstrip('.')}; see `{command} --help`"


def _with_default_microphone(arguments: list[str]) -> list[str]:
    """`--mic` alone means the default device; typer options cannot leave out their value."""
    completed: list[str] = []
    following = [*arguments[1:], "-"]
    for argument, after in zip(arguments, following, strict=True):
        completed.append(argument)
        if argument == "--mic" and after.startswith("-"):
            completed.append("default")
    return completed
