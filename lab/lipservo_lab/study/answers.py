"""The answers of a study: one line of JSON each, appended, on the disk before it is confirmed.

One server writes them, which holds a lock on the file. What a crash or a full disk left of a line
was never confirmed: it is laid beside the file, and the rater's page asks again.
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

#: What a rater may type of a sentence; no sentence is longer.
MOST_CHARACTERS: Final = 500
TORN_SUFFIX: Final = ".torn"
_MOST_RATERS: Final = 10_000

Record = Mapping[str, Any]


@dataclass(slots=True)
class RaterRecord:
    """One rater. answers: records by the number of the item; sheet: the number of theirs."""

    sheet: int
    answers: dict[int, Record] = field(default_factory=dict)
    has_left: bool = False


@dataclass(frozen=True, slots=True)
class Answers:
    """What a file holds. torn: bytes at its end that are no whole line.

    is_simulated: by a rehearsal.
    """

    raters: dict[str, RaterRecord]
    torn: bytes = b""
    is_simulated: bool = False


class AlreadyAnsweredError(StudyError):
    """Another answer was given to this item before."""


class UnknownRaterError(StudyError):
    """No such rater has consented."""


def parse_answers(path: Path, content: bytes, identity: str) -> Answers:
    """Read the lines of a study's file. Raises StudyError, naming the line, for a damaged one."""
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
            _add(raters, record)
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            if isinstance(error, StudyError):
                raise
            raise StudyError(
                f"{path}, line {number}: is no record of an answer; delete this line"
            ) from error
    return Answers(raters, torn, is_simulated)


def read_answers(path: Path, identity: str) -> Answers:
    """Read a file while it is written or after. Raises StudyError."""
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
    """The time to the second, UTC."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def _add(raters: dict[str, RaterRecord], record: Record) -> None:
    """Apply one line of the answer file to the raters, by name; KeyError for an unknown rater."""
    match record["kind"]:
        case "join":
            raters[record["rater"]] = RaterRecord(int(record["sheet"]))
        case "answer":
            raters[record["rater"]].answers[int(record["number"])] = record
        case "leave":
            raters[record["rater"]].has_left = True


class AnswerFile:
    """The file of the one server of a study; its methods may be called from any thread."""

    def __init__(self, path: Path, identity: str) -> None:
        """Open or make the answer file and lock it.

        Raises StudyError: another server has it, or it cannot be used.
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
            #: So many bytes at the end were no whole line.
            self.n_torn = len(answers.torn)
            if answers.torn:
                self._lay_beside(answers.torn)
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
        """Return a rater's record. Raises UnknownRaterError."""
        try:
            return self.raters[name]
        except KeyError:
            raise UnknownRaterError(f"rater {name} has not begun here; begin anew") from None

    def join(self, name: str, n_sheets: int) -> RaterRecord:
        """A rater who consented gets the next sheet; one who is known keeps theirs.

        Raises StudyError where it cannot be written.
        """
        with self._lock:
            if name not in self.raters:
                if len(self.raters) >= _MOST_RATERS:
                    raise StudyError(f"{self.path}: has {_MOST_RATERS} raters, and takes no more")
                sheet = len(self.raters) % n_sheets
                self._keep({"kind": "join", "rater": name, "sheet": sheet, "at": now()})
            return self.raters[name]

    def answer(self, name: str, number: int, given: Record) -> None:
        """Keep an answer; the same one again is none.

        given: `answer`, and what else is known of how it came. Raises UnknownRaterError,
        AlreadyAnsweredError, and StudyError where it cannot be written.
        """
        with self._lock:
            before = self.rater(name).answers.get(number)
            if before is not None:
                if before["answer"] == given["answer"]:
                    return
                raise AlreadyAnsweredError(f"rater {name}: item {number + 1} has an answer already")
            self._keep({"kind": "answer", "rater": name, "number": number, **given, "at": now()})

    def leave(self, name: str) -> None:
        """Note that a rater leaves: none of their answers shall count. Raises as `answer`."""
        with self._lock:
            if not self.rater(name).has_left:
                self._keep({"kind": "leave", "rater": name, "at": now()})

    def _keep(self, record: Record) -> None:
        self._append(record)
        _add(self.raters, record)

    def _append(self, record: Record) -> None:
        """Append a record: on the disk whole, or not in the file. Raises StudyError."""
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

    def _lay_beside(self, torn: bytes) -> None:
        with self.path.with_name(self.path.name + TORN_SUFFIX).open("ab") as file:
            file.write(torn + b"\n")
            file.flush()
            os.fsync(file.fileno())
