"""The yardstick does not move: hashes of the alignments that scored talkers are judged by.

Labels for training get better, by teachers and other aligners; figures stay comparable only while
the references of the scored talkers are what they were. A file holds a line an utterance, its name
and 16 hex digits over beams and phones of its alignment, `-` for one that cannot be aligned. The
alignments themselves are labels of corpora, which are not handed on.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path

from lipservo_lab.corpus.alignment_cache import AlignedUtterance, CacheError

_NOT_ALIGNED = "-"


def alignment_hash(aligned: AlignedUtterance) -> str:
    """Of beams and phones; neither the text's score nor what was guessed is part of it."""
    if aligned.error:
        return _NOT_ALIGNED
    return hashlib.sha256(json.dumps([aligned.beams, aligned.phones]).encode()).hexdigest()[:16]


def hash_lines(alignments: Iterable[AlignedUtterance]) -> str:
    """The file's text, by name."""
    lines = (f"{each.name} {alignment_hash(each)}\n" for each in alignments)
    return "".join(sorted(lines))


def read_hashes(path: Path) -> dict[str, str]:
    """The hash by the utterance's name. Raises CacheError for a file that is none of hashes."""
    try:
        pairs = [line.split() for line in path.read_text(encoding="utf-8").splitlines()]
        return dict(pairs)
    except (OSError, ValueError) as error:
        raise CacheError(f"{path}: no file of NAME HASH a line ({error})") from error


def moved(alignments: Iterable[AlignedUtterance], hashes: Mapping[str, str]) -> list[str]:
    """Names of the utterances whose alignment is not the one that was fixed; others are passed."""
    return [
        each.name
        for each in alignments
        if each.name in hashes and hashes[each.name] != alignment_hash(each)
    ]
