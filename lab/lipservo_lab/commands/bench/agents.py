"""`lipservo bench agent`: whether an agent remembers what was heard.

`lipservo bench day`: whether an agent speaks all day through whatever happens.
"""

from typing import Annotated

import typer

from lipservo.commands.options import Json, Quiet
from lipservo.terminal.output import RESULTS, machine_class, print_json, progress_bar
from lipsync.errors import check_extra


def agent(
    turns: Annotated[int, typer.Option(min=1, help="How many the agent says.")] = 2_000,
    barge_ins: Annotated[int, typer.Option(min=0, help="How many of them are cut off.")] = 300,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Let a Pipecat agent speak and be interrupted, and compare what it remembers."""
    if barge_ins > turns:
        raise typer.BadParameter("at most one barge-in a turn")
    check_extra("pipecat", "`bench agent`")
    from lipservo_lab.bench.agents.agent_figures import agent_figures

    with progress_bar(quiet=quiet) as advance:
        figures = agent_figures(turns, barge_ins, lambda done, of: advance("turns", done, of))
    _print({**figures, "machine": machine_class()}, as_json=as_json)


def day(
    minutes: Annotated[
        float, typer.Option(min=1.0, help="How long; fewer than twelve bring less trouble.")
    ] = 12.0,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Let an agent and a face run through loads, restarts, pulled cables, stops and starts.

    On real processes, with a PulseAudio sink in place of a loudspeaker.
    """
    check_extra("pipecat", "`bench day`")
    from lipservo_lab.bench.agents.day_figures import EVENTS, day_figures

    events = {name: max(1, round(n * minutes / 12.0)) for name, n in EVENTS.items()}
    with progress_bar(quiet=quiet) as advance:
        figures = day_figures(minutes, events, lambda done, of: advance("events", done, of))
    _print({**figures, "machine": machine_class()}, as_json=as_json)


def _print(figures: dict[str, object], *, as_json: bool) -> None:
    if as_json:
        print_json(figures)
        return
    for name, value in figures.items():
        RESULTS.print(f"{name}: {value}", soft_wrap=True, highlight=False)
