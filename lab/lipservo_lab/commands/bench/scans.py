"""`lipservo bench scans`: registration of scans whose truth is known."""

from typing import Annotated, Any

import typer

from lipservo.commands.options import Json, Quiet
from lipservo.terminal.output import RESULTS, machine_class, print_json
from lipservo.terminal.progress_bar import progress_bar
from lipsync.extras import check_extra


def scans(
    n_scans: Annotated[
        int, typer.Option("--scans", min=2, help="How many scans of each kind.")
    ] = 12,
    seed: Annotated[int, typer.Option(help="Other faces, samples and noise.")] = 0,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure how near registered points come to where they are, on scans made of the mean face.

    The distance is that of the same point of the skin: sliding along the surface counts.
    """
    check_extra("trimesh", "bench scans")
    from lipservo_lab.bench.scans.scan_figures import scan_figures
    from lipsync.face.model import load_face

    with progress_bar(quiet=quiet) as advance:
        figures: dict[str, Any] = scan_figures(load_face(), n_scans, seed, advance)
    figures["machine"] = machine_class()
    if as_json:
        print_json(figures)
        return
    for name, row in figures["cases"].items():
        RESULTS.print(
            f"{name}: {row['median_mm']} mm median, {row['p95_mm']} at 95 %; lips "
            f"{row['lips_median_mm']}, {row['lips_p95_mm']}; where speech moves the skin "
            f"{row['moved_median_mm']}, {row['moved_p95_mm']} (of "
            f"{row['unregistered_moved_median_mm']} mm); surface {row['surface_median_mm']}; "
            f"{row['seconds_per_scan']} s a scan",
            soft_wrap=True,
            highlight=False,
        )
