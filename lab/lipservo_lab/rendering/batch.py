"""A folder of lines, rendered by joblib on all cores or on a cluster.

What fails is reported and leaves the rest.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import joblib
from threadpoolctl import threadpool_limits

from lipservo.rendering.rendered import Rendered, Rendering, rendered_line
from lipservo.rendering.spoken_line import LineError, Script, given_text, is_file
from lipservo_lab.rendering.cluster import done_on_cluster
from lipsync.errors import UserError
from lipsync.offline.performance import SUFFIX, performance_bytes
from lipsync.output_file import write_whole

if TYPE_CHECKING:
    from distributed import Client

_SOUNDS = (".wav", ".flac", ".ogg", ".opus", ".mp3", ".aiff", ".aif", ".w64")
_PHONES = (".TextGrid", ".textgrid", ".json")


@dataclass(frozen=True, slots=True)
class BatchLine:
    """One line of a batch."""

    sound: Path
    script: Script
    output: Path


def lines_of(folder: Path, output: Path) -> list[BatchLine]:
    """Every sound of a folder, in order of their names, each to `output`/NAME.perf.

    The phonemes come from NAME.TextGrid or NAME.json beside it, else from NAME.txt, else from the
    recogniser. Raises LineError for a folder without sounds, for two sounds of one name, and for a
    text that cannot be read.
    """
    sounds = [p for p in sorted(folder.iterdir()) if p.suffix.lower() in _SOUNDS]
    if not sounds:
        raise LineError(f"{folder}: holds no sound file ({' '.join(_SOUNDS)})")
    by_name: dict[str, Path] = {}
    for sound in sounds:
        other = by_name.setdefault(sound.stem, sound)
        if other != sound:
            raise LineError(f"{sound}: {other.name} has the same name; rename one of them")
    return [
        BatchLine(sound, _script_beside(sound), output / f"{sound.stem}{SUFFIX}")
        for sound in sounds
    ]


def _script_beside(sound: Path) -> Script:
    for suffix in _PHONES:
        phones = sound.with_suffix(suffix)
        if phones.is_file():
            return Script(phones=phones)
    text = sound.with_suffix(".txt")
    if not text.is_file():
        return Script()
    return Script(text=given_text(str(text)))


def render_all(
    lines: Sequence[BatchLine],
    how: Rendering,
    n_processes: int,
    advance: Callable[[], None] = lambda: None,
    cluster: "Client | None" = None,
) -> tuple[list[Rendered], dict[str, str]]:
    """What was rendered, in order, and of each sound that was not the reason, in one line.

    cluster: works in place of our processes. Each file is written here, so that a worker that dies
    leaves nothing behind. Raises ClusterError.
    """
    rendered: list[Rendered] = []
    failed: dict[str, str] = {}
    if cluster is None:
        made = _made_here(lines, how, n_processes, advance)
    else:
        made = _made_there(cluster, lines, how, advance)
    for line, outcome in zip(lines, made, strict=True):
        try:
            rendered.append(_written(outcome, line.output))
        except UserError as error:
            failed[str(line.sound)] = str(error)
    return rendered, failed


#: The bytes of a performance file, and what is told of it; or why there is none.
_Made = tuple[bytes, Rendered] | str


def _made_here(
    lines: Sequence[BatchLine], how: Rendering, n_processes: int, advance: Callable[[], None]
) -> Iterator[_Made]:
    work = joblib.Parallel(n_jobs=n_processes, return_as="generator")
    for outcome in work(joblib.delayed(_made)(line, how) for line in lines):
        advance()
        yield outcome


def _made_there(
    client: "Client", lines: Sequence[BatchLine], how: Rendering, advance: Callable[[], None]
) -> Iterator[_Made]:
    """Workers have working folders of their own: every path is whole."""
    how = replace(
        how,
        model=_absolute(how.model),
        offline=_absolute(how.offline),
        expression=_absolute_face(how.expression),
    )
    whole = [
        replace(
            line,
            sound=line.sound.absolute(),
            script=replace(line.script, phones=_absolute(line.script.phones)),
        )
        for line in lines
    ]
    return done_on_cluster(client, partial(_made, how=how), whole, advance)


def _made(line: BatchLine, how: Rendering) -> _Made:
    """One BLAS thread a process: the same sums everywhere, and no core used twice."""
    try:
        with threadpool_limits(limits=1):
            performance, done = rendered_line(line.sound, line.script, how)
            return performance_bytes(performance), done
    except UserError as error:
        return str(error)


def _written(made: _Made, output: Path) -> Rendered:
    """Raises UserError, for a line that failed and for a file that cannot be written."""
    if isinstance(made, str):
        raise UserError(made)
    content, done = made
    write_whole(output, content)
    return replace(done, output=output)


def _absolute(path: Path | None) -> Path | None:
    return None if path is None else path.absolute()


def _absolute_face(face: str | None) -> str | None:
    """The name of a shipped face is no path."""
    return str(Path(face).absolute()) if face is not None and is_file(face) else face
