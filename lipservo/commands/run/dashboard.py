"""The command `dashboard`, which serves the web page of a running face."""

import os
import socket
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from firmware_bridge.process.logs import face_logs
from lipservo.commands.options import (
    Control,
    DashboardListen,
    FaceName,
    Model,
    OpenPage,
    OpenToThisComputer,
    Quiet,
    TokenFile,
)
from lipservo.commands.run.running import chosen_faces
from lipservo.commands.run.voice_choice import access_file, text_of
from lipservo.terminal.output import MESSAGES
from lipsync.errors import UserError, check_extra

if TYPE_CHECKING:
    from lipservo.dashboard.face_link import FaceLink
    from lipservo.dashboard.first_hour.first_hour import FirstHour


def dashboard(
    *,
    face: FaceName = None,
    control: Control = None,
    listen: DashboardListen = None,
    token_file: TokenFile = None,
    open_to_this_computer: OpenToThisComputer = False,
    open_page: OpenPage = False,
    model: Model = None,
    listener: Annotated[int | None, typer.Option(hidden=True)] = None,
    parent: Annotated[int | None, typer.Option(hidden=True)] = None,
    quiet: Quiet = False,
) -> None:
    """Serve a web page of a running face: watch it, set it up, stop it; /docs describes its API.

    The page is a separate process: the face continues if the page ends.
    """
    check_dashboard()
    if parent is not None:
        _become_background_child(parent)
    from lipservo.access.token_file import read_token
    from lipservo.dashboard.child import bound_dashboard

    given = read_token(text_of(token_file))
    token = read_token(
        text_of(access_file(token_file, open_to_this_computer=open_to_this_computer))
    )
    with socket.socket(fileno=listener) if listener else bound_dashboard(listen, token) as bound:
        from lipservo.dashboard.face_link import FaceLink

        link = FaceLink(found_face(face, control), given, control)
        with face_logs(face or "", "dashboard", quiet=quiet):
            serve_page(bound, link, token, open_page=open_page, model=model, quiet=quiet)


def serve_page(
    bound: socket.socket,
    link: "FaceLink",
    token: str | None,
    *,
    open_page: bool,
    model: Path | None = None,
    quiet: bool = False,
    hour: "FirstHour | None" = None,
) -> None:
    """Serve the dashboard until a signal ends it; print its address, and open a browser if wanted.

    bound: the listening socket. token: that browsers must send; None: not needed on this computer.
    model: file of the face model; None: the shipped one. hour: the setup of a new face, or None.
    """
    from lipservo.dashboard.child import address_line, address_of
    from lipservo.dashboard.web.access_layer import OneTimeCode
    from lipservo.dashboard.web.serving import serve

    code = OneTimeCode(os.geteuid()) if open_page and token is not None else None
    path = "" if hour is None else "first-hour"

    def ready() -> None:
        if not quiet:
            MESSAGES.print(address_line(bound, token, path))
        if open_page and _has_a_screen():
            import webbrowser

            webbrowser.open(address_of(bound, None if code is None else code.code, path))

    serve(bound, link, token, ready, model, code, hour)


def check_dashboard() -> None:
    """Raise MissingExtraError unless the libraries that the dashboard needs are installed."""
    for library in ("nicegui", "prometheus_client"):
        check_extra(library, "the dashboard")


def _has_a_screen() -> bool:
    """Return whether a graphical browser can open; one in the terminal would cover the face."""
    return sys.platform == "darwin" or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY")))


def found_face(face: str | None, control: Path | None) -> Callable[[], Path]:
    """Return a function that finds the control socket of a running face.

    It is the face named `face`, that at `control`, or the only one that runs. Later calls of the
    function find a face of the same name, which may have been started again. The function raises
    UserError and ControlError.
    """
    wanted_name = [face]

    def find() -> Path:
        """Return the path of the face's control socket; keep the face's name for later calls."""
        faces = chosen_faces(wanted_name[0], control)
        if not faces:
            raise UserError("no face runs; start one with `lipservo daemon`")
        if len({each.name for each in faces}) > 1:
            names = ", ".join(sorted(each.name for each in faces))
            raise UserError(f"several faces run: {names}; choose one with --face")
        wanted_name[0] = faces[0].name
        return faces[0].path

    return find


def _become_background_child(parent: int) -> None:
    """Run at low priority, and end with process `parent`; raise typer.Exit if that has ended."""
    from firmware_bridge.process.operating_system import die_with_parent, write_from_background

    die_with_parent()
    write_from_background()
    os.nice(5)
    if os.getppid() != parent:  # the parent ended before the first line took effect
        raise typer.Exit(1)
