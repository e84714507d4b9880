"""The yardstick does not move: hashes of the alignments that scored talkers are measured by.

Labels for training get better, by teachers and other aligners; figures stay comparable only while
the references of the scored talkers are what they were. A file holds a line an utterance, its name
and 16 hex digits over beams and phones of its alignment, `-` for one that cannot be aligned. The
alignments themselves are labels of corpora, which are not handed on.
"""

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path

from lipservo_lab.corpus.alignment_cache import AlignedUtterance, CacheError
from lipsync.output_file import write_whole

_NOT_ALIGNED = "-"


def alignment_hash(aligned: AlignedUtterance) -> str:
    """Return a digest of an alignment's beams and phones, without score and guesses."""
    if aligned.error:
        return _NOT_ALIGNED
    return hashlib.sha256(json.dumps([aligned.beams, aligned.phones]).encode()).hexdigest()[:16]


def read_hashes(path: Path) -> dict[str, str]:
    """The hash by the utterance's name. Raises CacheError for a file that is none of hashes."""
    try:
        pairs = [line.split() for line in path.read_text(encoding="utf-8").splitlines()]
        return dict(pairs)
    except (OSError, ValueError) as error:
        raise CacheError(f"{path}: expected a name and a hash on each line ({error})") from error


def fix_alignments(path: Path, alignments: Iterable[AlignedUtterance]) -> list[str]:
    """Names of the utterances whose alignment is not the one that was fixed.

    Those that the file at `path` has not are fixed now: they are added to it. Raises CacheError for
    a file of something else, OutputError for one that cannot be written.
    """
    fixed = read_hashes(path) if path.exists() else {}
    found = {each.name: alignment_hash(each) for each in alignments}
    if found.keys() - fixed.keys():
        lines = (f"{name} {digest}\n" for name, digest in sorted((found | fixed).items()))
        write_whole(path, "".join(lines))
    return [name for name, digest in found.items() if fixed.get(name, digest) != digest]
