"""The command `lipservo`."""

import sys

import typer

from firmware_bridge.bus import BusError
from lipservo.commands import (
    bench,
    bench_recognition,
    builder,
    calibration,
    doctor,
    health,
    processes,
    recognition,
    setup_servos,
    sim_bus,
    street,
    trace,
    training,
)
from lipservo.face_life import FaceStopped, exit_status
from lipservo.output import complain
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
app.command("doctor")(doctor.doctor)
app.command("jog")(builder.jog)
app.command("neutral")(builder.neutral)
app.command("setup-servos")(setup_servos.setup_servos)
app.command("new-face")(builder.new_face)
app.command("bridge-process", hidden=True)(processes.bridge_process)
app.command("speech-process", hidden=True)(processes.speech_process)
app.command("stop")(processes.stop)
app.command()(health.health)
app.add_typer(bench.app, name="bench")
app.add_typer(trace.app, name="trace")


def main() -> None:
    """Run the command line. What the user can mend ends in clear lines and status 1."""
    try:
        app(_with_default_microphone(sys.argv[1:]))
    except (UserError, BusError) as error:
        # Notes say what became of the servos.
        complain("\n".join([str(error), *getattr(error, "__notes__", [])]))
        sys.exit(1)
    except FaceStopped as stop:
        complain(str(stop))
        sys.exit(exit_status(stop.report, stop.signal_number))


def _with_default_microphone(arguments: list[str]) -> list[str]:
    """`--mic` alone means the default device; typer options cannot leave out their value."""
    completed: list[str] = []
    for argument, following in zip(arguments, [*arguments[1:], "-"], strict=True):
        completed.append(argument)
        if argument == "--mic" and following.startswith("-"):
            completed.append("default")
    return completed
