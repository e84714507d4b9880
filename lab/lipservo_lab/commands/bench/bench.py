"""`lipservo bench NAME`: the figures that this project claims, measured here and now.

`replay`: how much faster than sound a file is replayed. `cost`: what a face's speech process costs
at rest and speaking. `fleet`: many faces at once. `cluster`: lines while workers die. `inputs`: odd
files and texts of every kind, and what becomes of each. `study`: whether the figures of a study
hold the truth, by simulated studies.
"""

import tempfile
import time
from collections.abc import Callable
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Annotated, cast

import typer

from calibration.simulated.robot_family import RobotFamily
from lipservo.commands.options import Json, Quiet
from lipservo.commands.run.dashboard import check_dashboard
from lipservo.terminal.output import MESSAGES, RESULTS, progress_bar
from lipservo_lab.commands.bench.printing import print_figures
from lipservo_lab.commands.options import Inverted, Lazy
from lipsync.errors import UserError, check_extra

#: What the replay figure replays: a sentence of 3 s and an utterance of 20 s.
_REPLAYED = ("grid_s1/audio/bbaf3s.flac", "librispeech/audio/1089-134691-0011.opus")

Corpora = Annotated[
    Path | None,
    typer.Option(help="Folder with the corpora grid_s1 and librispeech (docs/benchmarks.md)."),
]


def synthesis(corpora: Corpora = None, as_json: Json = False, quiet: Quiet = False) -> None:
    """Measure the speed of a replay, a run's start-up and memory, and miss rates of AnimPhos.

    Speed: seconds of sound for each second; start-up: until the first servo goal. A miss is a
    phoneme for which Wei and Deng's selection finds no recorded motion that follows on from the
    last one (docs/motion.md).
    Without --corpora: replay speed on the bundled clip, and no miss rates.
    """
    from lipservo_lab.bench import speed_figures as measure

    began_s = time.perf_counter()
    if corpora is not None and not corpora.is_dir():
        raise UserError(f"{corpora}: no such folder; give the one that holds grid_s1")
    known = [] if corpora is None else [corpora / name for name in _REPLAYED]
    recordings = [path for path in known if path.is_file()]
    figures: dict[str, float] = {}
    with (
        resources.as_file(resources.files("lipservo.clips") / "welcome.flac") as clip,
        progress_bar(quiet=quiet) as advance,
    ):
        advance("synthesis", 0, 3)
        figures["replay_speed"] = measure.replay_speed(recordings or [clip])
        advance("synthesis", 1, 3)
        figures |= measure.live_figures()
        advance("synthesis", 2, 3)
        if corpora is not None and (corpora / "grid_s1").is_dir():
            figures |= measure.miss_rates(corpora / "grid_s1")
        else:
            MESSAGES.print("no miss rates: give --corpora, a folder that holds the corpus grid_s1")
    print_figures(figures, as_json=as_json, began_s=began_s)


def bus(as_json: Json = False, quiet: Quiet = False) -> None:
    """Measure processor time, transfer times and recovery of the servo loop, on simulated servos.

    Processor time is that of the loop's process and of one tick, beside a loop that uses
    dynamixel-sdk, or rustypot if it is installed; for Feetech and hobby servos beside a loop
    written by hand. Transfer times are compared with the time that the bytes take on the wire.
    Recovery: from a silent servo, lost packets, a pulled plug and a bus that stands still.
    """
    check_extra("smbus2", "bench bus")
    from lipservo_lab.bench.bus import bus_figures as measure
    from lipservo_lab.bench.bus.bus_figures import cpu_ratios
    from lipservo_lab.bench.bus.feetech_tick_figures import feetech_tick_ratios
    from lipservo_lab.bench.bus.process_cpu_figures import process_ratios
    from lipservo_lab.bench.bus.pulse_tick_figures import pulse_tick_ratios
    from lipservo_lab.bench.bus.stall_figures import stall_figures
    from lipservo_lab.bench.bus.tick_cpu_figures import tick_ratios

    began_s = time.perf_counter()
    parts: list[Callable[[], dict[str, float]]] = [
        process_ratios,
        tick_ratios,
        cpu_ratios,
        measure.wire_figures,
        measure.fault_figures,
        measure.replug_figures,
        stall_figures,
        feetech_tick_ratios,
        pulse_tick_ratios,
    ]
    figures: dict[str, float | str] = {"scheduling": measure.scheduling()}
    with progress_bar(quiet=quiet) as advance:
        for number, part in enumerate(parts):
            advance("bus", number, len(parts))
            figures |= part()
    print_figures(figures, as_json=as_json, began_s=began_s)


def faults(
    every: Annotated[
        int, typer.Option(min=1, help="Play only every Nth case; 4: a quarter of all.")
    ] = 1,
    whole: Annotated[
        bool, typer.Option("--whole", help="Combine all faults, starts and stops: 8 times as many.")
    ] = False,
    stops: Annotated[
        bool,
        typer.Option(
            "--stops", help="Instead: stop real faces in every way and in every trouble, 10 s each."
        ),
    ] = False,
    signals: Annotated[
        bool,
        typer.Option(
            "--signals", help="Instead: end every command that moves servos by signals; 8 s each."
        ),
    ] = False,
    starved: Annotated[
        bool,
        typer.Option("--starved", help="Instead: a face with a tenth of a processor; needs root."),
    ] = False,
    minutes: Annotated[
        float, typer.Option(min=1.0, help="Minutes of --starved; then it starts up to 40 faces.")
    ] = 20.0,
    only: Annotated[
        str,
        typer.Option(help="With --stops: one part: stops, freezes, statements, restarts, idle."),
    ] = "",
    bus: Annotated[
        str, typer.Option(help="Kind of bus: dynamixel, feetech, maestro or pca9685.")
    ] = "dynamixel",
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Run the servo loop with every kind of fault of servos and bus, on a virtual clock.

    A case is a fault with a number of servos and a rate, after a strict or a tolerant start, with
    one kind of stop or none; --whole combines each fault with all starts and stops.

    --stops, --signals and --starved instead run lipservo as users do, in processes of its own, with
    simulated servos. --stops: a face is stopped by command, dashboard, program or signal while a
    plug is pulled, a process hangs and so on; its parts are `stops`, `freezes`, `statements` (is
    what lipservo says about torque true?), `restarts` of Feetech servos, and `idle` (idle
    connections to the dashboard). --signals: commands get INT, TERM, HUP, QUIT or KILL. Exit status
    1 if a servo, face or command did what it must not; each such case is listed.
    """
    from lipservo_lab.bench.fault_figures import (
        STOP_PARTS,
        campaign_figures,
        signal_campaign_figures,
        starved_figures,
        stop_campaign_figures,
    )
    from lipservo_lab.campaigns.fault_campaign import CAMPAIGN_BUSES

    if stops + signals + starved + whole > 1:
        raise UserError("give one of --stops, --signals, --starved and --whole")
    if bus not in CAMPAIGN_BUSES or (bus != "dynamixel" and (stops or signals or starved)):
        raise UserError(
            f"--bus {bus}: use one of {', '.join(CAMPAIGN_BUSES)}; --stops, --signals and "
            "--starved work with dynamixel alone"
        )
    if only and not (stops and only in STOP_PARTS):
        raise UserError(f"--only {only}: give --stops, and one of {', '.join(STOP_PARTS)}")
    began_s = time.perf_counter()
    with progress_bar(quiet=quiet) as bar:
        advance = partial(bar, "cases")
        if stops:
            figures, broken = stop_campaign_figures(every, advance, only)
        elif signals:
            figures, broken = signal_campaign_figures(every, advance)
        elif starved:
            figures, broken = starved_figures(minutes, advance)
        else:
            figures, broken = campaign_figures(every, advance, bus=bus, whole=whole)
    for line in broken:
        MESSAGES.print(line, soft_wrap=True)
    print_figures(figures, as_json=as_json, began_s=began_s)
    if broken:
        raise typer.Exit(1)


def house(as_json: Json = False, quiet: Quiet = False) -> None:
    """Measure the size of lipservo's code, and what of it runs, against the project's limits.

    Figures: the source files that a tick of the servo loop and a stop run through, and a tick's
    calls from file to file; the modules that `run` loads; processor time of some commands; disk
    space when installed; lines of code of each folder. The command needs a checkout. Figures above
    their limits are listed at the end, with exit status 1.
    """
    from lipservo_lab.bench.house.house_figures import house_figures

    began_s = time.perf_counter()
    with progress_bar(quiet=quiet) as advance:
        figures = house_figures(advance)
    over = figures["over"]
    print_figures(figures, as_json=as_json, began_s=began_s)
    for line in over:
        MESSAGES.print(line, highlight=False)
    if over:
        raise typer.Exit(1)


def endurance(
    cycles: Annotated[int, typer.Option(min=1_000, help="Ticks of the servo loop.")] = 100_000,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Drive simulated servos for hours of virtual time; count memory, open files, wrong goals.

    Ctrl-C ends the run with the figures so far. Exit status 1 if a servo got a goal, a speed or
    torque that it must not get.
    """
    from firmware_bridge.stop_signals import SignalCounter
    from lipservo_lab.campaigns.endurance import endurance_figures, what_went_wrong

    began_s = time.perf_counter()
    with progress_bar(quiet=quiet) as advance, SignalCounter() as signals:
        figures = endurance_figures(
            cycles,
            lambda n_done: advance("cycles", n_done, cycles),
            lambda: signals.count > 0,
        )
    print_figures(figures, as_json=as_json, began_s=began_s)
    wrong = what_went_wrong(figures)
    for line in wrong:
        MESSAGES.print(line)
    if wrong:
        raise typer.Exit(1)


def calibration(
    seeds: Annotated[
        str, typer.Option(metavar="A-B", help="Random seeds, such as 0-19; a robot for each.")
    ] = "0-19",
    family: Annotated[
        RobotFamily | None,
        typer.Option(
            help="Kind of robot: own: compliant skin and backlash; elastic: lips that touch, any "
            "joints. Default: both."
        ),
    ] = None,
    ways: Annotated[
        bool,
        typer.Option(
            "--ways",
            help="With family elastic: also test every way to calibrate (measured, guided, "
            "practise, port, hobby, dots) on robots of 1 to 12 servos that the first seed makes.",
        ),
    ] = False,
    kills: Annotated[
        int,
        typer.Option(min=0, help="Number of captures to kill and resume, for each of 3 trackers."),
    ] = 0,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Calibrate simulated robots whose build is hidden, and score the results: medians and worst.

    The command also puts faults into robots, to see whether they are reported, and tests twenty
    mouths that cannot close. --kills ends `calibrate measure` at random times, and starts the same
    command again.
    """
    from lipservo_lab.bench.calibration.every_robot import bench_figures, read_seeds

    if ways and family is RobotFamily.OWN:
        raise typer.BadParameter("--ways needs --family elastic")
    numbers = read_seeds(seeds)
    began_s = time.perf_counter()
    with progress_bar(quiet=quiet) as advance:
        figures = bench_figures(
            numbers,
            list(RobotFamily) if family is None else [family],
            ways=ways,
            kills=kills,
            advance=partial(advance, "robots and mouths"),
        )
    print_figures(figures, as_json=as_json, began_s=began_s)


def replay(
    sound: Annotated[
        Path | None, typer.Argument(help="Sound file; default: 20 s of the bundled clip.")
    ] = None,
    times: Annotated[int, typer.Option(min=1, help="Number of replays; the median counts.")] = 5,
    as_json: Json = False,
) -> None:
    """Measure how much faster than real time `lipservo replay` is."""
    from lipservo_lab.bench.speed_figures import replay_speed
    from lipservo_lab.repeated_recording import repeated

    with (
        resources.as_file(resources.files("lipservo.clips") / "welcome.flac") as clip,
        tempfile.TemporaryDirectory() as folder,
    ):
        replayed = sound or repeated(clip, Path(folder) / "welcome.wav")
        figures = {"replay_speed": replay_speed([replayed], times)}
    print_figures(figures, as_json=as_json)


def cost(
    against: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Folder of another checkout to compare with; its servo goals must be equal.",
        ),
    ] = None,
    config: Annotated[str, typer.Option(help="Name of a shipped face.")] = "face_sim",
    listens: Annotated[
        bool, typer.Option("--listens", help="Let the face listen to a recording, not speak.")
    ] = False,
    cycles: Annotated[int, typer.Option(min=1, help="Number of cycles of speech and rest.")] = 5,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure the processor time of a face's speech process, speaking and at rest.

    The process runs on a virtual clock; a cycle has 3 s of speech and 8 s of rest. Exit status 1 if
    servo goals differ from those of --against by .005 degrees, or their times by a microsecond.
    """
    from lipservo_lab.bench.cost.cost_figures import cost_figures

    if against is not None and not (against / "lipservo" / "runtime").is_dir():
        raise UserError(f"--against {against}: holds no lipservo; give the folder of a checkout")
    began_s = time.perf_counter()
    with progress_bar(quiet=quiet) as advance:
        figures = cost_figures(
            None if against is None else against.resolve(),
            config,
            "file" if listens else "voice",
            cycles,
            partial(advance, "turns"),
        )
    print_figures(figures, as_json=as_json, began_s=began_s)
    if figures.get("goals_apart_deg", 0.0) >= 0.005 or figures.get("goals_apart_s", 0.0) >= 1e-6:
        raise typer.Exit(1)


#: Of all faces that are asked so many are real or answer as such.
_N_FACES = 100


def fleet(
    daemons: Annotated[
        int, typer.Option(min=1, max=_N_FACES, help="Real daemons among the 100 faces.")
    ] = 12,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure how soon 100 faces answer status and stop, beside five more that are dead or hung.

    --daemons are real faces; servers that give the same answers stand for the others. Exit status 1
    unless all 100 faces confirm the stop and the command names the other five.
    """
    check_dashboard()
    from lipservo_lab.bench.fleet_figures import fleet_figures

    with progress_bar(quiet=quiet) as advance:
        figures = fleet_figures(daemons, _N_FACES - daemons, advance)
    print_figures(figures, as_json=as_json)
    if figures["confirmed"] < 1.0 or figures["named"] < figures["dead_and_hung"]:
        raise typer.Exit(1)


def cluster(
    lines: Annotated[int, typer.Option(min=10, help="Number of short lines to render.")] = 2000,
    kill_every_s: Annotated[
        float, typer.Option(min=1.0, help="Seconds between kills of a worker.")
    ] = 60.0,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Count scripted lines that are lost or rendered twice while processes of a cluster are killed.

    `lines render-folder` runs on a Dask cluster of this computer; workers are killed again and
    again, the scheduler once. Exit status 1 if a line is lost.
    """
    for library in ("distributed", "joblib"):
        check_extra(library, "bench cluster")
    from lipservo_lab.campaigns.cluster_campaign import cluster_figures

    with progress_bar(quiet=quiet) as advance:
        figures = cluster_figures(lines, kill_every_s, advance)
    print_figures(figures, as_json=as_json)
    if figures["lost"]:
        raise typer.Exit(1)


def inputs(
    each: Annotated[int, typer.Option(min=1, help="Number of inputs of each kind.")] = 84,
    seed: Annotated[int, typer.Option(help="Random seed of the inputs.")] = 0,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Feed odd labels, sounds, ranges, texts, markers, photographs and names to their readers.

    Each input is generated together with the right answer. Exit status 1 if an input made its
    reader raise a traceback or hang, or was read wrongly without a message.
    """
    for library in ("ezc3d", "PIL"):
        check_extra(library, "bench inputs")
    from lipservo_lab.bench.inputs.input_figures import input_figures

    began_s = time.perf_counter()
    with progress_bar(quiet=quiet) as advance:
        figures = input_figures(each, seed, advance)
    wrong = {} if as_json else cast("dict[str, list[object]]", figures.pop("wrong"))
    print_figures(figures, as_json=as_json, began_s=began_s)
    for kind, lines in wrong.items():
        for line in lines:
            RESULTS.print(f"{kind}: {line}", soft_wrap=True, highlight=False, markup=False)
    if any(figures[name] for name in ("tracebacks", "hangs", "silently_wrong")):
        raise typer.Exit(1)


def study(
    studies: Annotated[int, typer.Option(min=1, max=100_000, help="Studies to simulate.")] = 200,
    honest: Annotated[int, typer.Option(min=2, max=1000, help="Number of careful raters.")] = 16,
    lazy: Lazy = 1,
    inverted: Inverted = 1,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Simulate studies with raters of known preferences, evaluated like a study with people.

    The result `coverage` is the share of 95 % intervals that contain the true value, over ratings,
    pairs and words read.
    """
    from lipservo_lab.study.rehearsal import Crew, coverage_figures
    from lipservo_lab.study.sheets import Size

    began_s = time.perf_counter()
    with progress_bar(quiet=quiet) as advance:
        found = coverage_figures(
            studies, Crew(honest, lazy, lazy, lazy, inverted), Size(), partial(advance, "studies")
        )
    print_figures(found, as_json=as_json, began_s=began_s)
