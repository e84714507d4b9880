"""Sources and pages of a checkout; lines of code by room, and the budgets that they are held to.

A line counts when it holds a token that is neither comment nor docstring; blank lines cost nothing,
so documenting is free.
"""

import ast
import io
import tokenize
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Final

import yaml

_DOCUMENTED: Final = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
_NO_CODE: Final = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}


@dataclass(frozen=True, slots=True)
class Budget:
    """How many code lines some folders may have together.

    Attributes
    ----------
    folders
        From the root of the checkout.
    ceiling
        The most code lines; this number is only ever lowered.
    """

    folders: tuple[str, ...]
    ceiling: int


@cache
def house_table() -> Mapping[str, Any]:
    """Read `house.yaml`: budgets and bars."""
    text = (resources.files("lipservo_lab.bench.house") / "house.yaml").read_text("utf-8")
    table: Mapping[str, Any] = yaml.safe_load(text)
    return table


def budgets() -> dict[str, Budget]:
    """Return the budgets by room; `wheel` and `all` are the last."""
    table = house_table()
    rooms = {**table["rooms"], "wheel": table["wheel"], "all": table["all"]}
    return {name: Budget(tuple(row["folders"]), row["ceiling"]) for name, row in rooms.items()}


def code_lines(source: str) -> int:
    """Return how many lines of a Python source hold code."""
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in _NO_CODE:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, _DOCUMENTED) and ast.get_docstring(node, clean=False) is not None:
            docstring = node.body[0]
            lines.difference_update(range(docstring.lineno, (docstring.end_lineno or 0) + 1))
    return len(lines)


def sources(root: Path, folder: str) -> Iterator[Path]:
    """Yield every Python file of ours in a folder; tests and built copies are none.

    Copies are built beside a pyproject.toml: a folder `build` further down is ours.
    """
    for path in sorted((root / folder).rglob("*.py")):
        inside = path.relative_to(root / folder).parts[:-1]
        is_ours = inside[:1] != ("build",) and not {"tests", "node_modules"} & set(inside)
        if is_ours and not any(part.startswith(".") for part in inside):
            yield path


def pages(root: Path) -> list[Path]:
    """Return all Markdown pages of a checkout."""
    folders = ("config", "docs", "examples", "firmware", "lipservo", "lipsync", "lab", ".github")
    found = [*root.glob("*.md"), *(root / "client").glob("*.md")]
    return sorted([*found, *(path for each in folders for path in (root / each).rglob("*.md"))])


def room_lines(root: Path) -> dict[str, int]:
    """Count the code lines of every room, of the wheel and of all, in a checkout."""
    table = budgets()
    lines = {
        path.relative_to(root).as_posix(): code_lines(path.read_text("utf-8"))
        for folder in table["all"].folders
        for path in sources(root, folder)
    }
    rooms = {name: row for name, row in table.items() if name not in ("wheel", "all")}
    room_counts = dict.fromkeys(rooms, 0)
    for file, count in lines.items():
        # A file belongs to the room with the longest matching folder.
        depth = {
            name: max((len(each) for each in row.folders if file.startswith(f"{each}/")), default=0)
            for name, row in rooms.items()
        }
        room = max(depth, key=lambda name: depth[name])
        if depth[room]:
            room_counts[room] += count
    in_wheel = tuple(f"{folder}/" for folder in table["wheel"].folders)
    room_counts["wheel"] = sum(count for file, count in lines.items() if file.startswith(in_wheel))
    return {**room_counts, "all": sum(lines.values())}
