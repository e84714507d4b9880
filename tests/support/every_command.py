"""Every command of the program, the lab's too, as it is when it has been imported."""

from collections.abc import Iterator
from typing import Any

import typer.main

from lipservo.cli import app
from lipservo.commands.lazy_group import LazyGroup


def every_command(group: Any = None, path: str = "lipservo") -> Iterator[tuple[str, Any]]:
    """(What is typed, command) of the program itself, its groups, and of every command in them."""
    group = typer.main.get_command(app) if group is None else group
    yield path, group
    if isinstance(group, LazyGroup):
        hidden = [name for name, command in group.table.items() if command.hidden]
        for name in (*group.list_commands(None), *hidden):
            assert group.get_command(None, name) is not None, name
            yield from every_command(group.get_command(None, name), f"{path} {name}")
    else:
        for name, command in getattr(group, "commands", {}).items():
            yield from every_command(command, f"{path} {name}")
