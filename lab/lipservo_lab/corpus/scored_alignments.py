"""Hashes of the alignments that scored speakers are measured by, so that the reference stays fixed.

Labels for training improve, by teachers and other aligners; scores only stay comparable while the
references of the scored speakers do not change. A file has a line an utterance: its name, and 16
hex digits over beams and phones of its alignment, or `-` if it cannot be aligned. The alignments
themselves are labels of corpora, which are not redistributed.
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
    """Return the hashes by utterance name. Raises CacheError for a file of anything else."""
    try:
        pairs = [line.split() for line in path.read_text(encoding="utf-8").splitlines()]
        return dict(pairs)
    except (OSError, ValueError) as error:
        raise CacheError(f"{path}: expected a name and a hash on each line ({error})") from error


def fix_alignments(path: Path, alignments: Iterable[AlignedUtterance]) -> list[str]:
    """Return the names of utterances whose alignment differs from the hash in a file.

    Utterances that the file at `path` lacks are added to it. Raises CacheError for a file of
    something else, OutputError for one that cannot be written.
    """
    fixed = read_hashes(path) if path.exists() else {}
    found = {alignment.name: alignment_hash(alignment) for alignment in alignments}
    if found.keys() - fixed.keys():
        lines = (f"{name} {digest}\n" for name, digest in sorted((found | fixed).items()))
        write_whole(path, "".join(lines))
    return [name for name, digest in found.items() if fixed.get(name, digest) != digest]
