"""`lipservo bench fleet`: many faces at once; `lipservo bench cluster`: lines while workers die."""

from typing import Annotated

import typer

from lipservo.commands.options import Json, Quiet
from lipservo.commands.run.dashboard import check_dashboard
from lipservo.terminal.output import progress_bar
from lipservo_lab.commands.bench.printing import print_figures
from lipsync.errors import check_extra

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
