"""`lipservo bench agent`: whether an agent remembers what was heard.

`lipservo bench day`: whether an agent speaks all day through whatever happens.
"""

from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Annotated, Final

import typer

from lipservo.commands.options import Json, Quiet
from lipservo.terminal.output import progress_bar
from lipservo_lab.commands.bench.printing import print_figures
from lipsync.errors import UserError, check_extra

if TYPE_CHECKING:
    from lipservo_lab.bench.agents.agent_figures import Speaks


def agent(
    only: Annotated[
        list[str] | None,
        typer.Option(
            "--only",
            help="Only this framework: pipecat, livekit, openai or wyoming; may be repeated. "
            "Default: all.",
        ),
    ] = None,
    turns: Annotated[int, typer.Option(min=3, max=300, help="How often the agent speaks.")] = 60,
    barge_ins: Annotated[int, typer.Option(min=0, help="How many turns are interrupted.")] = 30,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure whether voice agents remember only what a person could hear, when interrupted.

    A turn is what an agent says at once. In one turn the face restarts, in another it is absent.
    Each framework needs its own packages (`make agents`).
    """
    if barge_ins > turns:
        raise typer.BadParameter("--barge-ins: at most as many as --turns")
    from lipservo_lab.bench.agents.agent_figures import agent_figures

    names = tuple(only or _AGENTS)
    if unknown := [name for name in names if name not in _AGENTS]:
        raise UserError(f"--only {unknown[0]}: use one of {', '.join(_AGENTS)}")
    figures: dict[str, object] = {}
    with progress_bar(quiet=quiet) as advance:
        for name in names:
            speaks = _agent(name)
            figures[name] = agent_figures(speaks, turns, barge_ins, partial(advance, name))
    print_figures(figures, as_json=as_json)


_AGENTS: Final = ("pipecat", "livekit", "openai", "wyoming")


def _agent(name: str) -> "Speaks":
    """Return what speaks as an agent of a framework. Raises MissingExtraError."""
    if name != "openai":
        check_extra(name, "`bench agent`")
    try:
        module = import_module(f"lipservo_lab.bench.agents.{name}_agent")
    except ImportError as missing:
        raise UserError(f"{name}: {missing}; `make agents` installs what it needs") from missing
    speaks: Speaks = getattr(module, f"{name}_agent")
    return speaks


def day(
    minutes: Annotated[
        float, typer.Option(min=1.0, help="Duration in minutes; below 12, fewer events happen.")
    ] = 12.0,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure what an agent and a face lose by load, restarts, pulled cables, stops and starts.

    Figures: turns that did not move the mouth, growth of memory and threads, time until the agent
    notices a pulled cable. Both are real processes; a PulseAudio sink replaces the loudspeaker. The
    exit status does not depend on the figures.
    """
    check_extra("pipecat", "`bench day`")
    from lipservo_lab.bench.agents.day_figures import EVENTS, day_figures

    events = {name: max(1, round(n * minutes / 12.0)) for name, n in EVENTS.items()}
    with progress_bar(quiet=quiet) as advance:
        figures = day_figures(minutes, events, lambda done, of: advance("events", done, of))
    print_figures(figures, as_json=as_json)
