"""The answers of a study: one line of JSON each, on the disk before the answer is confirmed.

One server appends them; it holds a lock on the file. An incomplete last line, left by a crash or a
full disk, was never confirmed: it is moved to another file, and the rater's page sends it again.
"""

import contextlib
import fcntl
import json
import os
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from lipservo_lab.study.sheets import StudyError

#: Most characters that a rater may type for a sentence; no sentence is longer.
MOST_CHARACTERS: Final = 500
TORN_SUFFIX: Final = ".torn"
_MOST_RATERS: Final = 10_000

Record = Mapping[str, Any]


@dataclass(slots=True)
class RaterRecord:
    """One rater.

    sheet: number of the rater's sheet. answers: records by the number of the item on it. has_left:
    whether the rater withdrew the answers.
    """

    sheet: int
    answers: dict[int, Record] = field(default_factory=dict)
    has_left: bool = False


@dataclass(frozen=True, slots=True)
class Answers:
    """The content of an answer file.

    raters: by name. torn: bytes at its end that are no whole line. is_simulated: whether a
    rehearsal wrote it.
    """

    raters: dict[str, RaterRecord]
    torn: bytes = b""
    is_simulated: bool = False


class AlreadyAnsweredError(StudyError):
    """The item has another answer already."""


class UnknownRaterError(StudyError):
    """No rater of this name has consented."""


def parse_answers(path: Path, content: bytes, identity: str) -> Answers:
    """Return the answers in the content of a study's file.

    identity: of the study. Raises StudyError, naming the line, for a damaged line, and for answers
    of another study.
    """
    *lines, torn = content.split(b"\n")
    raters: dict[str, RaterRecord] = {}
    is_simulated = False
    for number, line in enumerate(lines, 1):
        try:
            record = json.loads(line)
            if number == 1 and record["study"] != identity:
                raise StudyError(
                    f"{path}: holds answers of study {record['study']}, this is {identity}; move "
                    "it away, or name the other study"
                )
            is_simulated |= "simulated" in record
            _apply_record(raters, record)
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            if isinstance(error, StudyError):
                raise
            raise StudyError(
                f"{path}, line {number}: is no record of an answer; delete this line"
            ) from error
    return Answers(raters, torn, is_simulated)


def read_answers(path: Path, identity: str) -> Answers:
    """Read a file of answers, also while a server writes it. Raises StudyError."""
    try:
        return parse_answers(path, path.read_bytes(), identity)
    except OSError as error:
        raise StudyError(
            f"{path}: {error.strerror}; `lipservo study serve` writes it, `rehearse` for a trial"
        ) from error


def first_record(identity: str) -> Record:
    """Return the first record of a file of answers."""
    return {"kind": "study", "study": identity, "at": now()}


def line_of(record: Record) -> bytes:
    """Return a record as a line of the file."""
    return json.dumps(record, ensure_ascii=False).encode() + b"\n"


def now() -> str:
    """Return the present time to the second, UTC."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def _apply_record(raters: dict[str, RaterRecord], record: Record) -> None:
    """Apply one record of the answer file to `raters`, by name; KeyError for an unknown rater."""
    match record["kind"]:
        case "join":
            raters[record["rater"]] = RaterRecord(int(record["sheet"]))
        case "answer":
            raters[record["rater"]].answers[int(record["number"])] = record
        case "leave":
            raters[record["rater"]].has_left = True


class AnswerFile:
    """The answer file of the one server of a study.

    Its methods may be called from any thread. raters: by name.
    """

    def __init__(self, path: Path, identity: str) -> None:
        """Open or make the answer file and lock it.

        Raises StudyError if another server has it, if it is damaged, or if it cannot be used.
        """
        self.path = path
        self._lock = threading.Lock()
        try:
            self._file = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT, 0o600)
        except OSError as error:
            raise StudyError(f"{path}: cannot be written: {error.strerror}") from error
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            content = path.read_bytes()
            answers = parse_answers(path, content, identity)
            self.raters = answers.raters
            #: Bytes at the end that were no whole line.
            self.n_torn = len(answers.torn)
            if answers.torn:
                self._save_torn(answers.torn)
                os.ftruncate(self._file, len(content) - len(answers.torn))
            if len(content) == len(answers.torn):
                self._append(first_record(identity))
        except BlockingIOError:
            os.close(self._file)
            raise StudyError(
                f"{path}: another `lipservo study serve` serves this study; end it first"
            ) from None
        except OSError as error:
            os.close(self._file)
            raise StudyError(f"{path}: cannot be written: {error.strerror}") from error
        except BaseException:
            os.close(self._file)
            raise

    def __enter__(self) -> "AnswerFile":
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._file)

    def rater(self, name: str) -> RaterRecord:
        """Return the record of a rater by name. Raises UnknownRaterError."""
        try:
            return self.raters[name]
        except KeyError:
            raise UnknownRaterError(f"rater {name} has not begun here; begin anew") from None

    def join(self, name: str, n_sheets: int) -> RaterRecord:
        """Return the record of a rater who consented; a new rater gets the next sheet.

        Raises StudyError if it cannot be written, or if there are too many raters.
        """
        with self._lock:
            if name not in self.raters:
                if len(self.raters) >= _MOST_RATERS:
                    raise StudyError(f"{self.path}: has {_MOST_RATERS} raters, and takes no more")
                sheet = len(self.raters) % n_sheets
                self._store({"kind": "join", "rater": name, "sheet": sheet, "at": now()})
            return self.raters[name]

    def answer(self, name: str, number: int, fields: Record) -> None:
        """Store an answer; the same answer to the same item again changes nothing.

        number: of the item. fields: `answer`, `seconds`, `plays`. Raises UnknownRaterError,
        AlreadyAnsweredError for another answer than before, and StudyError if it cannot be written.
        """
        with self._lock:
            earlier = self.rater(name).answers.get(number)
            if earlier is not None:
                if earlier["answer"] == fields["answer"]:
                    return
                raise AlreadyAnsweredError(f"rater {name}: item {number + 1} has an answer already")
            self._store({"kind": "answer", "rater": name, "number": number, **fields, "at": now()})

    def leave(self, name: str) -> None:
        """Note that a rater leaves: none of that rater's answers count.

        Raises UnknownRaterError, and StudyError if it cannot be written.
        """
        with self._lock:
            if not self.rater(name).has_left:
                self._store({"kind": "leave", "rater": name, "at": now()})

    def _store(self, record: Record) -> None:
        self._append(record)
        _apply_record(self.raters, record)

    def _append(self, record: Record) -> None:
        """Append a record: completely on the disk, or not in the file at all. Raises StudyError."""
        line = line_of(record)
        size = os.fstat(self._file).st_size
        try:
            if os.write(self._file, line) != len(line):
                raise OSError(28, "No space left on device")
            os.fsync(self._file)
        except OSError as error:
            with contextlib.suppress(OSError):
                os.ftruncate(self._file, size)
            raise StudyError(f"{self.path}: the answer was not stored: {error.strerror}") from error

    def _save_torn(self, torn: bytes) -> None:
        """Append bytes of an incomplete line to the file of the same name with `TORN_SUFFIX`."""
        with self.path.with_name(self.path.name + TORN_SUFFIX).open("ab") as file:
            file.write(torn + b"\n")
            file.flush()
            os.fsync(file.fileno())
