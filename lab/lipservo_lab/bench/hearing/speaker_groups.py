"""In which groups the speakers of a corpus are counted."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

from lipservo_lab.corpus.speaker_table import SPEAKERS_FILE, read_speakers
from lipsync.errors import UserError


class SpeakerGroupError(UserError):
    """Nobody says what kind of voice a speaker has; the message is one line."""


def speaker_groups(
    by: Literal["speaker", "group"] | None, corpus: Path, table: Path | None
) -> Callable[[str], Sequence[str]]:
    """From a speaker's name to the names of the groups; none where nothing was asked for.

    table: of the speakers; None: the one in the corpus's folder. Raises SpeakerGroupError where
    there is none, and for a table nobody asked for; TranscriptError for one that cannot be read.
    """
    if by != "group" and table is not None:
        raise SpeakerGroupError(f"--groups {table} is for --by group; give both or neither")
    if by is None:
        return lambda _speaker: ()
    if by == "speaker":
        return lambda speaker: (speaker,)
    path = table or corpus / SPEAKERS_FILE
    if not path.is_file():
        raise SpeakerGroupError(
            f"{path}: no such file; --by group needs a table of speakers, with a first line like "
            "speaker,group,gender (--groups FILE)"
        )
    groups = read_speakers(path)
    return lambda speaker: groups.get(speaker, ("unknown",))
