"""The program's command line: runs a command, reports its errors, and exits with its status."""

import io
import sys

import typer

from firmware_bridge.errors import BusError
from firmware_bridge.port_names import named_ports
from firmware_bridge.process import logs
from firmware_bridge.process.runtime_folder import NEEDS_LINUX, RUNS_FACES, ControlError
from lipservo.runtime.servos.face_stopped import FaceStopped
from lipservo.terminal.output import complain
from lipsync.errors import EXTRA_OF, UserError

#: Phrases of pydantic in messages about a value, and ours.
_IN_OUR_WORDS = {
    "Input should be a valid number, unable to parse string as a number": "not a number",
    "Input should be a valid integer, unable to parse string as an integer": "not a whole number",
    "Input should be ": "should be ",
    "Value error, ": "",
}


def main() -> None:
    """Run the command line, and exit: status 0, 1 for what the user can mend, 2 for wrong usage.

    A command may set another status. Every error is reported in clear lines on stderr that begin
    with `lipservo:`.
    """
    for stream in (sys.stdin, sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # File names and terminals need not be UTF-8: print what cannot be encoded as escapes.
            stream.reconfigure(errors="backslashreplace")
    logs.set_up()
    arguments = _with_ports_joined(_with_default_devices(sys.argv[1:] or ["--help"]))
    try:
        status = _run(arguments)
    except typer.Exit as end:
        status = end.exit_code
    except typer.TyperException as error:
        complain(_usage_line(error))
        status = error.exit_code
    except (UserError, BusError, ControlError) as error:
        # Notes, added to errors on their way, tell the state of the servos.
        complain("\n".join([str(error), *getattr(error, "__notes__", [])]))
        status = 1
    except ModuleNotFoundError as error:
        library = (error.name or "").partition(".")[0]
        if library in EXTRA_OF:
            complain(f"{library} is not installed: `pip install '{EXTRA_OF[library]}'`")
        elif not RUNS_FACES and library in ("fcntl", "termios", "tty"):
            complain(NEEDS_LINUX)
        else:
            raise
        status = 1
    except typer.Abort:
        complain("the input ended before all questions were answered; no file was written")
        status = 1
    except UnicodeDecodeError as error:
        complain(f"an input file is not UTF-8 text (byte {error.start})")
        status = 1
    except OSError as error:
        where = "" if error.filename is None else f"{error.filename}: "
        complain(f"{where}{error.strerror or error}")
        status = 1
    except FaceStopped as stopped:
        complain(str(stopped))
        status = stopped.exit_status
    sys.exit(status or 0)


def _run(arguments: list[str]) -> int:
    """Run a command; `stop`, `start` and `status`, if possible, without the slow parser.

    Return its exit status.
    """
    if arguments[0] in ("stop", "start", "status"):
        from lipservo.commands.run.stop import run_without_parser

        if run_without_parser(arguments):
            return 0
    from lipservo import cli

    return int(cli.app(arguments, prog_name="lipservo", standalone_mode=False) or 0)


def _moved_option(error: typer.TyperException) -> str | None:
    """Return a line on where an option has moved; None for an error about anything else."""
    from lipservo.commands.options import MOVED_OPTIONS, OPTIONS_OF_THE_PROGRAM

    name = getattr(error, "option_name", "")
    command = getattr(getattr(error, "ctx", None), "info_name", "") or ""
    where = MOVED_OPTIONS.get(command, {}).get(name)
    if name in OPTIONS_OF_THE_PROGRAM:
        where = f"goes before the command: `lipservo {name} {command}`"
    return None if where is None else f"{name}: {where}"


def _usage_line(error: typer.TyperException) -> str:
    """Return one line for a usage error: the mistake, and which help to read."""
    message = " ".join(error.format_message().split())
    for pydantics, ours in _IN_OUR_WORDS.items():
        message = message.replace(pydantics, ours)
    context = getattr(error, "ctx", None)
    command = "lipservo" if context is None else context.command_path
    moved = _moved_option(error)
    if moved is not None:
        message = moved
    return f"{message.removeprefix('Invalid value: ').rstrip('.')}; see `{command} --help`"


def _with_default_devices(arguments: list[str]) -> list[str]:
    """Return the arguments with `default` after a bare `--mic` or `--play`.

    Options of typer need a value.
    """
    completed: list[str] = []
    for argument, after in zip(arguments, [*arguments[1:], "-"], strict=True):
        completed.append(argument)
        if argument in ("--mic", "--play") and after.startswith("-"):
            completed.append("default")
    return completed


def _with_ports_joined(arguments: list[str]) -> list[str]:
    """Return the arguments with `--port neck=A --port lips=B` as one option, `neck=A,lips=B`."""
    joined: list[str] = []
    first_port: int | None = None
    for argument in arguments:
        is_port = bool(joined) and joined[-1] == "--port" and named_ports(argument) is not None
        if is_port and first_port is not None:
            joined.pop()
            joined[first_port] += f",{argument}"
            continue
        if is_port:
            first_port = len(joined)
        joined.append(argument)
    return joined
