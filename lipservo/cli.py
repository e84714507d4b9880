"""The command `lipservo`."""

import sys

import typer

from firmware_bridge.bus import BusError
from firmware_bridge.runtime_folder import ControlError
from lipservo.commands import (
    bench,
    bench_recognition,
    builder,
    calibration,
    processes,
    recognition,
    sim_bus,
    stop,
    street,
    training,
)
from lipsync.errors import UserError

app = typer.Typer(
    name="lipservo",
    help="Live speech moves a physical mouth.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
for command in (
    street.run,
    street.daemon,
    street.replay,
    street.devices,
    training.train,
    calibration.calibrate,
    recognition.align,
    recognition.recognize,
    recognition.train_recognizer,
    recognition.plot_training,
):
    app.command()(command)
# Degrees may be negative, which looks like an option.
app.command("trim", context_settings={"ignore_unknown_options": True})(calibration.trim)
bench.app.command("recognition")(bench_recognition.recognition)
bench.app.command("listening")(bench_recognition.listening)
app.command("sim-bus")(sim_bus.sim_bus)
app.command("doctor")(builder.doctor)
app.command("jog")(builder.jog)
app.command("neutral")(builder.neutral)
app.command("setup-servos")(builder.setup_servos)
app.command("new-face")(builder.new_face)
app.command("bridge-process", hidden=True)(processes.bridge_process)
app.command("speech-process", hidden=True)(processes.speech_process)
app.command("stop")(stop.stop)
app.command("status")(stop.status)
app.command("limp")(stop.limp)
app.add_typer(bench.app, name="bench")


def main() -> None:
    """Run the command line. What the user can mend ends in clear lines and status 1."""
    try:
        app(_with_default_microphone(sys.argv[1:]))
    except (UserError, BusError, ControlError) as error:
        for line in str(error).splitlines():
            sys.stderr.write(f"lipservo: {line}\n")
        sys.exit(1)


def _with_default_microphone(arguments: list[str]) -> list[str]:
    """`--mic` alone means the default device; typer options cannot leave out their value."""
    completed: list[str] = []
    for argument, following in zip(arguments, [*arguments[1:], "-"], strict=True):
        completed.append(argument)
        if argument == "--mic" and following.startswith("-"):
            completed.append("default")
    return completed
