"""`wyoming`: makes a running face the loudspeaker of Home Assistant's satellites."""

import asyncio
import contextlib
from typing import Annotated

import typer

from lipservo.access.token_file import read_token
from lipservo.agents.listener import host_and_port
from lipservo.commands.options import Through, TokenFile
from lipservo.runtime.run_request import DEFAULT_LISTEN
from lipservo.terminal.output import MESSAGES
from lipsync.errors import UserError, check_extra


def wyoming(
    listen: Annotated[
        str,
        typer.Option(
            metavar="HOST:PORT",
            help="Address for satellites. Wyoming has no token: who reaches it may speak.",
        ),
    ] = "127.0.0.1:10601",
    through: Through = None,
    token_file: TokenFile = None,
) -> None:
    """Let Wyoming programs, such as Home Assistant's satellites, speak through a running face.

    It takes sound only (`snd`), and runs until Ctrl-C. Each sound is played to its end before the
    next begins.
    """
    host, port = host_and_port(listen)
    check_extra("wyoming", "`lipservo wyoming`")
    from lipservo_client.wyoming_face import serve_wyoming

    token = read_token(None if token_file is None else str(token_file))
    url = through or f"ws://{DEFAULT_LISTEN}"
    MESSAGES.print(f"wyoming: tcp://{listen} speaks through {url}", soft_wrap=True, highlight=False)
    try:
        with contextlib.suppress(KeyboardInterrupt):
            asyncio.run(serve_wyoming(host, port, url, token))
    except OSError as error:
        raise UserError(f"{listen}: cannot listen there: {error.strerror or error}") from error
