"""Render a folder of lines by joblib on all cores, or on a cluster.

Each file is written when its line is done. Failures are reported, and the other lines go on.
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
    """One line of a batch: its sound, its phones or text, and the file to write."""

    sound: Path
    script: Script
    output: Path


def lines_of(folder: Path, output: Path) -> list[BatchLine]:
    """Return a line for every sound of a folder, in order of names, written to `output`/NAME.perf.

    The phonemes are from NAME.TextGrid or NAME.json beside it, else from NAME.txt, else recognised.
    Raises LineError for a folder without sounds, for two sounds of one name, and for a text that
    cannot be read.
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
    """Return the lines whose output is missing, or not what rendering them would give."""
    return [line for line in lines if not is_rendered(line.output, line.sound, line.script, how)]


def render_all(
    lines: Sequence[BatchLine],
    how: Rendering,
    n_processes: int,
    advance: Callable[[], None] = lambda: None,
    cluster: Cluster | None = None,
) -> tuple[list[Rendered], dict[str, str]]:
    """Render lines; return those rendered, in order, and a reason for each sound that failed.

    how: options of the rendering. advance: called after each line. cluster: renders in place of
    processes here; None: `n_processes` of this computer. Files are written by this process, so that
    a worker that dies leaves nothing behind. Raises ClusterError, and UserError if a process here
    dies.
    """
    rendered: dict[int, Rendered] = {}
    failed: dict[int, str] = {}
    if cluster is None:
        outcomes = _render_here(lines, how, n_processes)
    else:
        outcomes = _render_on_cluster(cluster, lines, how)
    for n, outcome in outcomes:
        try:
            rendered[n] = _write_outcome(outcome, lines[n].output)
        except UserError as error:
            failed[n] = str(error)
        advance()
    return (
        [rendered[n] for n in sorted(rendered)],
        {str(lines[n].sound): failed[n] for n in sorted(failed)},
    )


#: The bytes of a performance file, and what is reported of it; or why there is none.
_Made = tuple[bytes, Rendered] | UserError


def _render_here(
    lines: Sequence[BatchLine], how: Rendering, n_processes: int
) -> Iterator[tuple[int, _Made]]:
    """Yield lines with their numbers as they are rendered on this computer, in any order.

    Raises UserError if a process of the pool has died.
    """
    work = joblib.Parallel(n_jobs=n_processes, return_as="generator_unordered")
    numbered = joblib.delayed(_render_numbered)
    try:
        yield from work(numbered(n, line, how) for n, line in enumerate(lines))
    except BrokenProcessPool as error:
        raise UserError(
            "a process that rendered has died, killed or out of memory (give fewer --jobs); what "
            "was rendered before is kept, and the same command goes on from it"
        ) from error


def _render_on_cluster(
    cluster: Cluster, lines: Sequence[BatchLine], how: Rendering
) -> Iterator[tuple[int, _Made]]:
    """Yield lines with their numbers as they are rendered on the cluster, in any order.

    Paths are made absolute, since workers have other working folders.
    """
    how = replace(
        how,
        model=_absolute(how.model),
        offline=_absolute(how.offline),
        expression=_absolute_face(how.expression),
    )
    absolute_lines = [
        replace(
            line,
            sound=line.sound.absolute(),
            script=_absolute_script(line.script),
        )
        for line in lines
    ]
    return cluster.done(partial(_render_line, how=how), absolute_lines)


def _absolute_script(script: Script) -> Script:
    """Return a script with the path of its phones made absolute."""
    if script.phones is None:
        return script
    return replace(script, phones=replace(script.phones, path=script.phones.path.absolute()))


def _render_numbered(n: int, line: BatchLine, how: Rendering) -> tuple[int, _Made]:
    return n, _render_line(line, how)


def _render_line(line: BatchLine, how: Rendering) -> _Made:
    """Return a line as rendered, or the error that says why it cannot be.

    With one BLAS thread a process: the same sums on every computer, and no core is used twice.
    """
    try:
        with threadpool_limits(limits=1):
            performance, rendered = rendered_line(line.sound, line.script, how)
            return performance_bytes(performance), rendered
    except UserError as error:
        return UserError(str(error))  # of a class that every process can read


def _write_outcome(outcome: _Made, output: Path) -> Rendered:
    """Write a rendered line; raises UserError for a line that failed or cannot be written."""
    if isinstance(outcome, UserError):
        raise outcome
    content, rendered = outcome
    write_whole(output, content)
    return replace(rendered, output=output)


def _absolute(path: Path | None) -> Path | None:
    return None if path is None else path.absolute()


def _absolute_face(face: str | None) -> str | None:
    """Return the path of a face file made absolute; the name of a shipped face stays."""
    return str(Path(face).absolute()) if face is not None and is_file(face) else face
