"""A folder of lines, rendered by joblib on all cores or on a cluster.

Each file is written when its line is done. What fails is reported and leaves the rest.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import joblib
from threadpoolctl import threadpool_limits

from lipservo.rendering.rendered import Rendered, Rendering, is_rendered, rendered_line
from lipservo.rendering.spoken_line import LineError, Script, given_text, is_file
from lipservo_lab.rendering.cluster import Cluster
from lipsync.errors import UserError
from lipsync.offline.performance import SUFFIX, performance_bytes
from lipsync.output_file import write_whole
from lipsync.phoneme_files.label_file import LabelFile

_SOUNDS = (".wav", ".flac", ".ogg", ".opus", ".mp3", ".aiff", ".aif", ".w64")
_PHONES = (".TextGrid", ".textgrid", ".json", ".csv", ".ctm", ".lab", ".tsv")


@dataclass(frozen=True, slots=True)
class BatchLine:
    """One line of a batch."""

    sound: Path
    script: Script
    output: Path


def lines_of(folder: Path, output: Path) -> list[BatchLine]:
    """Return a line for every sound of a folder, in order of names, written to `output`/NAME.perf.

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
    """Return the phones of the file beside a sound, else its text, else an empty script."""
    for suffix in _PHONES:
        phones = sound.with_suffix(suffix)
        if phones.is_file():
            return Script(phones=LabelFile(phones))
    text = sound.with_suffix(".txt")
    if not text.is_file():
        return Script()
    return Script(text=given_text(str(text)))


def unrendered(lines: Sequence[BatchLine], how: Rendering) -> list[BatchLine]:
    """Return the lines whose output is not already what rendering them would give."""
    return [each for each in lines if not is_rendered(each.output, each.sound, each.script, how)]


def render_all(
    lines: Sequence[BatchLine],
    how: Rendering,
    n_processes: int,
    advance: Callable[[], None] = lambda: None,
    cluster: Cluster | None = None,
) -> tuple[list[Rendered], dict[str, str]]:
    """Render lines; return those rendered, in order, and a reason for each sound that failed.

    cluster: renders in place of processes here. Files are written by this process, so that a worker
    that dies leaves nothing behind. Raises ClusterError, and UserError where a process here dies.
    """
    rendered: dict[int, Rendered] = {}
    failed: dict[int, str] = {}
    if cluster is None:
        made = _made_here(lines, how, n_processes)
    else:
        made = _made_there(cluster, lines, how)
    for n, outcome in made:
        try:
            rendered[n] = _written(outcome, lines[n].output)
        except UserError as error:
            failed[n] = str(error)
        advance()
    return (
        [rendered[n] for n in sorted(rendered)],
        {str(lines[n].sound): failed[n] for n in sorted(failed)},
    )


#: The bytes of a performance file, and what is told of it; or why there is none.
_Made = tuple[bytes, Rendered] | UserError


def _made_here(
    lines: Sequence[BatchLine], how: Rendering, n_processes: int
) -> Iterator[tuple[int, _Made]]:
    """Yield lines as they are rendered on this computer, numbered, in any order.

    Raises UserError where a process of the pool has died.
    """
    work = joblib.Parallel(n_jobs=n_processes, return_as="generator_unordered")
    numbered = joblib.delayed(_made_of)
    try:
        yield from work(numbered(n, line, how) for n, line in enumerate(lines))
    except BrokenProcessPool as error:
        raise UserError(
            "a process that rendered has died, killed or out of memory (give fewer --jobs); what "
            "was rendered before is kept, and the same command goes on from it"
        ) from error


def _made_there(
    cluster: Cluster, lines: Sequence[BatchLine], how: Rendering
) -> Iterator[tuple[int, _Made]]:
    """Yield lines as they are rendered on the cluster, numbered, in any order.

    Paths are made absolute, since workers have other working folders.
    """
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
            script=_whole(line.script),
        )
        for line in lines
    ]
    return cluster.done(partial(_made, how=how), whole)


def _whole(script: Script) -> Script:
    if script.phones is None:
        return script
    return replace(script, phones=replace(script.phones, path=script.phones.path.absolute()))


def _made_of(n: int, line: BatchLine, how: Rendering) -> tuple[int, _Made]:
    return n, _made(line, how)


def _made(line: BatchLine, how: Rendering) -> _Made:
    """One BLAS thread a process: the same sums everywhere, and no core used twice."""
    try:
        with threadpool_limits(limits=1):
            performance, done = rendered_line(line.sound, line.script, how)
            return performance_bytes(performance), done
    except UserError as error:
        return UserError(str(error))  # of a class that every process can read


def _written(made: _Made, output: Path) -> Rendered:
    """Raises UserError, for a line that failed and for a file that cannot be written."""
    if isinstance(made, UserError):
        raise made
    content, done = made
    write_whole(output, content)
    return replace(done, output=output)


def _absolute(path: Path | None) -> Path | None:
    return None if path is None else path.absolute()


def _absolute_face(face: str | None) -> str | None:
    """The name of a shipped face is no path."""
    return str(Path(face).absolute()) if face is not None and is_file(face) else face
