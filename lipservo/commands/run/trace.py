"""The command `trace diff`, which prints where two recorded runs differ in motion."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table

from lipservo.commands.options import Json
from lipservo.terminal.output import MESSAGES, RESULTS, print_json
from lipservo.traces.trace_diff import (
    Difference,
    IncomparableError,
    Tolerance,
    compare,
    excesses,
    overlay,
)
from lipservo.traces.trace_file import Trace, read_trace
from lipsync.errors import UserError, check_extra, check_inputs
from lipsync.face.model import FaceModel, load_face

app = typer.Typer(help="Compare files that --trace has written.", no_args_is_help=True)

#: Two traces that cannot be compared, as against 1, two that differ: as `diff` and `cmp` do.
_INCOMPARABLE = 2

First = Annotated[
    Path,
    typer.Argument(metavar="A", help="First trace, written by --trace; it may be gzipped (.gz)."),
]
Second = Annotated[Path, typer.Argument(metavar="B", help="Second trace.")]


@app.callback()
def about() -> None:
    """Compare files that --trace has written."""


@app.command()
def diff(
    a: First,
    b: Second,
    *,
    tolerance_mm: Annotated[
        float, typer.Option(min=0.0, help="Largest difference of lips and lip gap, mm.")
    ] = 0.5,
    tolerance_ms: Annotated[
        float, typer.Option(min=0.0, help="Largest time shift of the motion and of closures, ms.")
    ] = 10.0,
    tolerance_deg: Annotated[
        float, typer.Option(min=0.0, help="Largest difference of a servo's goals, degrees.")
    ] = 2.0,
    model: Annotated[
        list[Path] | None,
        typer.Option(
            help="Face model of a trace that was not made with the shipped model; once for each "
            "model."
        ),
    ] = None,
    plot: Annotated[
        Path | None, typer.Option(help="Draw both traces in this file, .png or .svg.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Compare two traces: differences in degrees, in millimetres of the lips, in milliseconds.

    Exit status 1 if a difference exceeds its tolerance, 2 if the traces cannot be compared.
    """
    tolerance = Tolerance(tolerance_mm, tolerance_deg, tolerance_ms * 1e-3)
    try:
        if plot is not None:
            from lipservo.traces.trace_diff import check_plot

            check_plot(plot)
            check_inputs(a, b, *(model or []))
            check_extra("matplotlib", "--plot")
        first, second = read_trace(a), read_trace(b)
        models = _face_models((first, second), model or [])
        laid = overlay(first, second, (models[0], models[1]))
        if plot is not None:
            from lipservo.traces.trace_diff import draw_difference

            draw_difference(plot, first, second, laid)
    except UserError as error:
        MESSAGES.print(f"lipservo: {error}")
        raise typer.Exit(_INCOMPARABLE) from error
    found = compare(first, second, laid, margin_mm=tolerance.mm)
    beyond = excesses(first.servos, found, tolerance)
    notes = [*first.notes, *second.notes, *_delay_note(first, second)]
    if as_json:
        print_json({"same": not beyond, "beyond": beyond, "notes": notes, **_figures(first, found)})
    else:
        _print_difference(first, second, found, beyond, notes)
    if beyond:
        raise typer.Exit(1)


def _face_models(traces: Sequence[Trace], files: Sequence[Path]) -> list[FaceModel]:
    """Return each trace's face model, found by checksum in `files` and the shipped one.

    Raises IncomparableError if a model is missing, or does not fit its trace.
    """
    known = {each.checksum: each for each in [load_face(), *map(load_face, files)]}
    for trace in traces:
        found = known.get(trace.model)
        if found is None:
            raise IncomparableError(
                f"{trace.name} was made with face model {trace.model}, not with "
                f"{' or '.join(known)}; give its file with --model"
            )
        if found.n_components != trace.coefficients.shape[1]:
            raise IncomparableError(
                f"{trace.name} has {trace.coefficients.shape[1]} coefficients per tick, but its "
                f"model {found.n_components}"
            )
    return [known[trace.model] for trace in traces]


def _delay_note(first: Trace, second: Trace) -> list[str]:
    """Return a line on the difference of the traces' delays from sound to face; [] if equal."""
    later_ms = 1e3 * (second.delay_s - first.delay_s)
    if abs(later_ms) < 0.05:
        return []
    return [f"{second.name} shows each sound {later_ms:+.1f} ms later; that is taken out below"]


def _figures(first: Trace, found: Difference) -> dict[str, object]:
    """Return the figures of a difference for JSON, with those of each servo under its name."""
    servos = {
        name: {"most_deg": most, "rms_deg": rms}
        for name, most, rms in zip(
            first.servos, found.servo_most_deg, found.servo_rms_deg, strict=True
        )
    }
    figures = asdict(found)
    del figures["servo_most_deg"], figures["servo_rms_deg"]
    return {**figures, "servos": servos}


def _print_difference(
    first: Trace, second: Trace, found: Difference, beyond: Sequence[str], notes: Sequence[str]
) -> None:
    """Print how two traces differ: overlap, lips, lag, closures, servos, and the worst times.

    beyond: lines on figures beyond their tolerance; notes: remarks on the traces.
    """
    for note in notes:
        MESSAGES.print(note)
    start_s, end_s = found.overlap_s
    lag = "nothing moves" if found.lag_s is None else f"{1e3 * found.lag_s:+.1f} ms"
    shift_s = max(found.closure_shifts_s, key=abs, default=0.0)
    RESULTS.print(
        f"{first.name} and {second.name}, sound {start_s:.2f} to {end_s:.2f} s\n"
        f"lips apart, most {found.lips_mm:.3f} mm, rms {found.lips_rms_mm:.3f} mm\n"
        f"lip gap off, most {found.gap_mm:.3f} mm\n"
        f"motion later by {lag}\n"
        f"closures: {len(found.closure_shifts_s)} in both, shifted by {1e3 * shift_s:+.1f} ms at "
        f"most; lost {_times(found.lost_closures_s)}; new {_times(found.new_closures_s)}",
        markup=False,
        highlight=False,
    )
    RESULTS.print(_servo_table(first, found))
    if found.worst:
        RESULTS.print(_moment_table(found))
    for line in beyond:
        RESULTS.print(f"beyond tolerance: {line}", markup=False, highlight=False)
    if not beyond:
        RESULTS.print("the same within tolerance", highlight=False)


def _servo_table(first: Trace, found: Difference) -> Table:
    """Return a table of each servo's largest and RMS difference in degrees."""
    table = Table(box=None)
    for header in ("servo", "off deg, most", "rms"):
        table.add_column(header, justify="left" if header == "servo" else "right")
    for row in zip(first.servos, found.servo_most_deg, found.servo_rms_deg, strict=True):
        table.add_row(escape(row[0]), f"{row[1]:.2f}", f"{row[2]:.2f}")
    return table


def _moment_table(found: Difference) -> Table:
    """Return a table of the times at which two traces differ most."""
    table = Table(title="worst moments", title_justify="left", box=None)
    for header in ("sound s", "phoneme", "lips mm", "gap mm", "servo", "off deg"):
        table.add_column(header, justify="left" if header in ("phoneme", "servo") else "right")
    for moment in found.worst:
        here, there = moment.phonemes
        table.add_row(
            f"{moment.sound_s:.2f}",
            escape(here if here == there else f"{here} -> {there}"),
            f"{moment.lips_mm:.2f}",
            f"{moment.gaps_mm[0]:.1f} -> {moment.gaps_mm[1]:.1f}",
            escape(moment.servo),
            f"{moment.off_deg:+.1f}",
        )
    return table


def _times(times_s: Sequence[float]) -> str:
    return ", ".join(f"at {time_s:.2f} s" for time_s in times_s) or "none"
