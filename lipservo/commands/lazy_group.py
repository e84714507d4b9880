"""A group of commands that are imported when they are run, not when they are listed.

Help, a typing error and `lipservo stop` are answered before NumPy could have been loaded. Commands
of another distribution (lipservo-lab) are found by entry points of the group `lipservo.commands`:
`bench` is a command at the top, `lines.render-folder` one of the group `lines`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points, version
from types import MappingProxyType
from typing import Any, ClassVar, Final

import typer
import typer.main
from typer.core import TyperGroup

from lipsync.errors import UserError

ENTRY_POINTS: Final = "lipservo.commands"
_NEGATIVE_NUMBERS: Final = {"ignore_unknown_options": True}


@dataclass(frozen=True, slots=True)
class Command:
    """An entry in a command group: the function to import, and its texts for the help.

    Attributes
    ----------
    target
        `module:name` of a function, or of a `typer.Typer` with commands of its own; empty for a
        command of lipservo-lab.
    help
        The command's line in the group's help.
    section
        The heading of the help under which the command is listed.
    takes_numbers
        Whether its arguments may be negative numbers, which look like options.
    hidden
        Whether the help leaves the command out: for lipservo's own processes.
    example
        Arguments that the command's help shows, without the command itself.
    """

    target: str
    help: str
    section: str = "Commands"
    takes_numbers: bool = False
    hidden: bool = False
    example: str = ""


class LazyGroup(TyperGroup):
    """A group of the commands in `table`, imported when run; `moved`: new names of old commands."""

    table: ClassVar[Mapping[str, Command]] = MappingProxyType({})
    moved: ClassVar[Mapping[str, str]] = MappingProxyType({})
    #: What the names of entry points begin with that add to this group.
    prefix: ClassVar[str] = ""

    def __init__(self, **attributes: Any) -> None:
        # Without rich: its help loads every command for a line of each.
        super().__init__(**{**attributes, "rich_markup_mode": None})

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ARG002
        """Return the names of the commands that help lists, in order."""
        names = [name for name, command in self.table.items() if not command.hidden]
        return names + [name for name in self._entry_points() if name not in self.table]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Import and return the command of that name; None for an unknown name.

        Raises
        ------
        BadParameter
            For an old name; the message has the new one.
        UserError
            For a command of a distribution that is not installed, or of another version.
        """
        if cmd_name in self.moved:
            raise typer.BadParameter(
                f"`{cmd_name}` is now `lipservo {self.moved[cmd_name]}`", ctx=ctx
            )
        path = f"{self.prefix.replace('.', ' ')}{cmd_name}"
        command = self.table.get(cmd_name)
        if command is not None and command.target:
            module, _, name = command.target.partition(":")
            return _click_command(path, getattr(import_module(module), name), command)
        added = self._entry_points().get(cmd_name)
        if added is not None:
            return _click_command(path, _load(added), Command("", ""))
        if command is not None:
            raise UserError(
                f"{self.prefix}{cmd_name} is part of lipservo-lab, which is not installed: "
                "`pip install lipservo-lab`, or `pip install -e ./lab` in a checkout"
            )
        return None

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return click's (name, command, remaining arguments).

        For an unknown name it fails with a message that has similar names.
        """
        if args and self.get_command(ctx, args[0]) is None and not args[0].startswith("-"):
            near = get_close_matches(args[0], self.list_commands(ctx))
            hint = f"; did you mean {', '.join(near)}?" if near else ""
            ctx.fail(f"No such command {args[0]!r}{hint}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the help's list of commands, under their headings, without importing them."""
        sections: dict[str, list[tuple[str, str]]] = {}
        for name in self.list_commands(ctx):
            command = self.table.get(name, Command("", "", "Of other distributions"))
            sections.setdefault(command.section, []).append((name, command.help))
        for section, rows in sections.items():
            with formatter.section(section):
                formatter.write_dl(rows)

    def shell_complete(self, ctx: Any, incomplete: str) -> list[Any]:
        """Return the commands and options whose names begin with `incomplete`."""
        from typer._click.shell_completion import CompletionItem

        return [
            CompletionItem(name, help=self.table[name].help if name in self.table else None)
            for name in self.list_commands(ctx)
            if name.startswith(incomplete)
        ]

    def _entry_points(self) -> dict[str, EntryPoint]:
        """Return the entry points of other distributions' commands in this group, by name."""
        found = {
            point.name.removeprefix(self.prefix): point
            for point in entry_points(group=ENTRY_POINTS)
            if point.name.startswith(self.prefix)
        }
        return {name: found[name] for name in sorted(found) if "." not in name}


def _load(point: EntryPoint) -> Any:
    """Import what an entry point names. Raises UserError unless its version is lipservo's."""
    own = version("lipservo")
    if point.dist is not None and point.dist.version != own:
        raise UserError(
            f"{point.dist.name} {point.dist.version} does not fit lipservo {own}: install both "
            f"of one version, `pip install lipservo=={own} {point.dist.name}=={own}`"
        )
    return point.load()


def _click_command(path: str, target: Any, command: Command) -> Any:
    """Return the click command of a function or a `typer.Typer`; path: the command's full name."""
    if isinstance(target, typer.Typer):
        return typer.main.get_group(target)
    # Typer makes a click command of a program that has this command alone.
    alone = typer.Typer(pretty_exceptions_enable=False)
    epilog = f"Example: lipservo {path} {command.example}" if command.example else None
    settings = _NEGATIVE_NUMBERS if command.takes_numbers else None
    name = path.rpartition(" ")[2]
    alone.command(name, context_settings=settings, hidden=command.hidden, epilog=epilog)(target)
    return typer.main.get_command(alone)
