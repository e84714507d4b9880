"""The option `--dashboard`: a page, served by a child process, of a face that is being started."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Final

import typer

from firmware_bridge.process.runtime_folder import socket_path
from lipservo.access.token_file import read_token
from lipservo.runtime.run_request import RunRequest, VoiceOptions
from lipservo.runtime.servos.assembly import load_settings
from lipservo.terminal.output import MESSAGES

#: Sound files that the page uploads and plays, where no folder was named.
_SOUNDS: Final = Path("lipservo") / "sounds"


def with_sounds(voice: VoiceOptions | None) -> VoiceOptions:
    """Return the voice options with a folder of sound files; None: those of a silent voice.

    A voice without such a folder gets one among the user's data, which is created if missing.
    """
    voice = voice or VoiceOptions()
    if voice.sounds is not None:
        return voice
    folder = _data_folder() / _SOUNDS
    folder.mkdir(parents=True, exist_ok=True)
    return replace(voice, sounds=str(folder))


@contextmanager
def dashboard_beside(
    request: RunRequest, listen: str | None, token_file: Path | None, *, open_page: bool
) -> Iterator[None]:
    """Serve, in a child process, the page of the face that the block runs, until the block ends.

    listen: HOST:PORT; None: a free port of this computer. token_file: from `access_file`. Raises
    UserError before anything moves.
    """
    from lipservo.commands.run.dashboard import check_dashboard

    check_dashboard()
    from lipservo.dashboard.child import address_line, bound_dashboard, dashboard_child

    file = None if token_file is None else str(token_file)
    token = read_token(file)
    path = request.control or socket_path(load_settings(request.config)[0].name)
    with bound_dashboard(listen, token) as listener:
        if not request.quiet:
            MESSAGES.print(address_line(listener, token))
        with dashboard_child(path, listener, file, model=request.model, open_page=open_page):
            yield


def check_page_options(
    listen: str | None,
    *,
    is_shown: bool,
    open_page: bool,
    token_file: Path | None = None,
    open_to_this_computer: bool = False,
) -> None:
    """Raise typer.BadParameter for an option of the dashboard if not `is_shown`.

    The other arguments: the dashboard's options as typed.
    """
    for name, given in (
        ("--dashboard-listen", listen is not None),
        ("--open", open_page),
        ("--token-file", token_file is not None),
        ("--open-to-this-computer", open_to_this_computer),
    ):
        if given and not is_shown:
            raise typer.BadParameter(f"{name} needs --dashboard")


def _data_folder() -> Path:
    """Return the folder of the user's application data (XDG base directory specification)."""
    given = os.environ.get("XDG_DATA_HOME", "")
    return Path(given) if given.startswith("/") else Path.home() / ".local" / "share"
