"""All commands of `lipservo`, for its command line and its help."""

import sys
from importlib.metadata import version
from typing import Annotated

import typer

from lipservo.commands.bench import bench
from lipservo.commands.bench import closures as bench_closures
from lipservo.commands.bench import face as bench_face
from lipservo.commands.bench import ladder as bench_ladder
from lipservo.commands.bench import languages as bench_languages
from lipservo.commands.bench import line as bench_line
from lipservo.commands.bench import microphone as bench_microphone
from lipservo.commands.bench import nonspeech as bench_nonspeech
from lipservo.commands.bench import readability as bench_readability
from lipservo.commands.bench import recognition as bench_recognition
from lipservo.commands.bench import replay as bench_replay
from lipservo.commands.bench import scans as bench_scans
from lipservo.commands.bench import shapes as bench_shapes
from lipservo.commands.bench import sync as bench_sync
from lipservo.commands.bench import texts as bench_texts
from lipservo.commands.build import builder, doctor, setup_servos, sim_bus
from lipservo.commands.calibrate import app as calibrate
from lipservo.commands.learn import (
    adaptation,
    alignment,
    expression,
    import_scans,
    import_video,
    recognizer,
    record_corpus,
    training,
)
from lipservo.commands.lines import offline_training, perform, render
from lipservo.commands.run import (
    calibrate_audio,
    dashboard,
    devices,
    export,
    health,
    processes,
    run,
    say,
    servo,
    set_value,
    stop,
    trace,
)

app = typer.Typer(name="lipservo", pretty_exceptions_enable=False)
for command in (
    run.run,
    run.daemon,
    say.say,
    run.replay,
    devices.devices,
    dashboard.dashboard,
    export.export,
    record_corpus.record_corpus,
    training.train,
    import_video.import_video,
    import_scans.import_scans,
    offline_training.train_offline,
    render.render,
    perform.perform,
    expression.train_expression,
    alignment.align,
    recognizer.recognize,
    recognizer.train_recognizer,
    recognizer.plot_training,
    adaptation.adapt,
):
    app.command()(command)
# A number may be negative, which looks like an option.
_NUMBERS = {"ignore_unknown_options": True}
app.command("trim", context_settings=_NUMBERS, hidden=True)(calibrate.old_trim)
app.command("jog", context_settings=_NUMBERS)(builder.jog)
bench.app.command("recognition")(bench_recognition.recognition)
bench.app.command("listening")(bench_recognition.listening)
bench.app.command("readability")(bench_readability.readability)
bench.app.command("nonspeech")(bench_nonspeech.nonspeech)
bench.app.command("ladder")(bench_ladder.ladder)
bench.app.command("languages")(bench_languages.languages)
bench.app.command("replay")(bench_replay.replay)
bench.app.command("line")(bench_line.line)
bench.app.command("closures")(bench_closures.closures)
bench.app.command("sync")(bench_sync.sync)
bench.app.command("microphone")(bench_microphone.microphone)
bench.app.command("face")(bench_face.face)
bench.app.command("scans")(bench_scans.scans)
bench.app.command("shapes")(bench_shapes.shapes)
bench.app.command("texts")(bench_texts.texts)
app.command("sim-bus")(sim_bus.sim_bus)
app.command("doctor")(doctor.doctor)
app.command("neutral")(builder.neutral)
app.command("setup-servos")(setup_servos.setup_servos)
app.command("new-face")(builder.new_face)
app.command("bridge-process", hidden=True)(processes.bridge_process)
app.command("speech-process", hidden=True)(processes.speech_process)
app.command("stop")(stop.stop)
app.command("start")(stop.start)
app.command("status")(stop.status)
app.command("limp")(stop.limp)
app.command("servo")(servo.servo)
app.command("set", context_settings=_NUMBERS)(set_value.set_value)
app.command()(health.health)
app.command("calibrate-audio")(calibrate_audio.calibrate_audio)
app.add_typer(calibrate.app, name="calibrate")
app.add_typer(bench.app, name="bench")
app.add_typer(trace.app, name="trace")


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
