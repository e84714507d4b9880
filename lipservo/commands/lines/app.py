"""The command group `lipservo lines`: scripted lines rendered, performed, aligned, recognised."""

from types import MappingProxyType

import typer

from lipservo.commands.lazy_group import Command, LazyGroup

_HERE = "lipservo.commands.lines"
_LAB = "Whole folders (lipservo-lab)"


class LinesGroup(LazyGroup):
    """The sub-commands of `lipservo lines`; lipservo-lab adds those that work on whole folders."""

    table = MappingProxyType(
        {
            "render": Command(f"{_HERE}.render:render", "Render a sound to a performance."),
            "perform": Command(f"{_HERE}.perform:perform", "Play a performance on a face."),
            "align": Command(f"{_HERE}.phones:align", "Find when each phone of a text is spoken."),
            "recognize": Command(f"{_HERE}.phones:recognize", "Print the phonemes of a sound."),
            "render-folder": Command("", "Render every sound of a folder.", _LAB),
            "align-folder": Command("", "Align all texts of a folder.", _LAB),
        }
    )
    prefix = "lines."


app = typer.Typer(name="lines", cls=LinesGroup)


@app.callback()
def lines() -> None:
    """Scripted lines: the whole line is known before the mouth moves (docs/scripted-lines.md)."""
