"""`bridge-process` and `speech-process`: the child processes of `daemon`, each with its request."""

import signal
from collections.abc import Sequence
from typing import Annotated

import typer

from firmware_bridge.process.lifeline import inherited_lifeline
from firmware_bridge.process.operating_system import die_with_parent, write_from_background
from firmware_bridge.stopping import StopLevel, StopRequest
from lipsync.errors import UserError

Fd = Annotated[int, typer.Option(hidden=True)]
Request = Annotated[str, typer.Option(help="The run as JSON: docs/architecture.md.")]


def bridge_process(
    channel: Fd,
    lifeline: Fd,
    control: Fd,
    board: Fd,
    live: Fd,
    request: Request,
    stopped: StopLevel | None = None,
    stopped_by: str = "",
    failed: Annotated[list[str] | None, typer.Option(metavar="INDEX=REASON")] = None,
    switched_off: Annotated[list[int] | None, typer.Option(metavar="INDEX")] = None,
) -> None:
    """Own the port and drive the servos; targets come through a socket. Started by `daemon`."""
    die_with_parent(signal.SIGTERM)
    write_from_background()
    alive = inherited_lifeline(lifeline)
    from lipservo.runtime.processes import Handed, run_bridge_process
    from lipservo.runtime.run_request import request_of_json

    status = run_bridge_process(
        request_of_json(request),
        Handed(channel, board, live, alive),
        control,
        stopped=None if stopped is None else StopRequest(stopped, stopped_by),
        given_up=dict(_failed_servos(failed or ())),
        switched_off=switched_off or [],
    )
    raise typer.Exit(status)


def speech_process(
    channel: Fd,
    lifeline: Fd,
    board: Fd,
    live: Fd,
    request: Request,
    agents: Annotated[int | None, typer.Option(hidden=True)] = None,
    zero_s: float | None = None,
) -> None:
    """Hear, recognise, and publish targets through a socket. Started by `daemon`.

    agents: the socket where voice agents connect. zero_s: monotonic time at which the sound began;
    a file is taken up where it is by now.
    """
    die_with_parent(signal.SIGTERM)
    write_from_background()
    alive = inherited_lifeline(lifeline)
    from lipservo.runtime.processes import Handed, run_speech_process
    from lipservo.runtime.run_request import request_of_json

    handed = Handed(channel, board, live, alive)
    run_speech_process(request_of_json(request), handed, agents, zero_s)


def _failed_servos(given: Sequence[str]) -> list[tuple[int, str]]:
    """Return (index, reason) of each `INDEX=REASON`. Raises UserError for any other text."""
    found = []
    for each in given:
        index, mark, reason = each.partition("=")
        if not mark or not index.isdigit():
            raise UserError(f"--failed {each}: write INDEX=REASON")
        found.append((int(index), reason))
    return found
