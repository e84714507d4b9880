"""What a command writes: refused before the work, and whole or not at all."""

import os
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from places import ROOT

from lipservo.traces.trace_file import TraceFile
from lipsync.errors import UserError
from lipsync.face.model import is_model
from lipsync.offline.offline_model_file import is_offline_model
from lipsync.offline.performance import (
    Performance,
    PerformedSound,
    is_performance,
    write_performance,
)
from lipsync.output_file import OutputError, check_output, write_whole, written_whole


def is_note(head: bytes) -> bool:
    return head.startswith(b"note:")


def listed(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


def test_a_good_place_is_accepted_and_left_as_it_was(tmp_path):
    (tmp_path / "old").write_text("note: old")
    for name in ("new", "old"):
        check_output(tmp_path / name, replaces=is_note, kind="note")
    assert listed(tmp_path) == {"old"}
    assert (tmp_path / "old").read_text() == "note: old"


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("no/folder/file", "there is no folder"),
        ("folder", "is a folder"),
        ("file/below", "Not a directory"),
        ("pipe", "is a device or a pipe"),
        ("to_null", "is a device or a pipe"),
        ("n" * 250, "File name too long"),
        ("zero\0byte", "null byte"),
        ("file", "exists already and is no note"),
        ("loop", "Too many levels of symbolic links"),
    ],
)
def test_a_place_that_cannot_be_written_is_refused_at_once(tmp_path, name, said):
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_text("my own")
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "to_null").symlink_to(os.devnull)
    (tmp_path / "loop").symlink_to("loop")
    before = listed(tmp_path)
    with pytest.raises(OutputError, match=said) as raised:
        check_output(tmp_path / name, replaces=is_note, kind="note")
    assert "\n" not in str(raised.value)
    assert listed(tmp_path) == before
    assert (tmp_path / "file").read_text() == "my own"


def test_each_kind_of_archive_replaces_its_own_kind_alone(tmp_path):
    models = ROOT / "lipsync" / "models"
    kinds = {
        is_model: (models / "grid_s1.npz").read_bytes(),
        is_offline_model: (models / "grid_s1_offline.npz").read_bytes(),
    }
    path = tmp_path / "line.perf"
    sound = PerformedSound("a.wav", "0" * 64, b"RIFF")
    faces = np.zeros((2, 5), np.float32)
    write_performance(Performance("0" * 16, faces, (), sound, "heard"), path)
    kinds[is_performance] = path.read_bytes()
    for replaces, own in kinds.items():
        found = [replaces(content[:4096]) for content in kinds.values()]
        assert found == [content is own for content in kinds.values()]
        assert not replaces(b"PK\3\4")
        assert not replaces(own[:36] + bytes(100))


def test_what_a_command_reads_is_never_written_over(tmp_path):
    source, other = tmp_path / "source", tmp_path / "link"
    source.write_text("note: source")
    other.symlink_to(source)
    with pytest.raises(OutputError, match="is an input of this command"):
        check_output(other, replaces=is_note, inputs=[None, source])


def test_a_file_is_written_whole_and_through_a_link(tmp_path):
    place, link = tmp_path / "place", tmp_path / "link"
    link.symlink_to(place)
    write_whole(link, "first")
    write_whole(link, b"second")
    assert place.read_bytes() == b"second"
    assert link.is_symlink()
    assert listed(tmp_path) == {"place", "link"}


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_what_breaks_off_leaves_the_old_file_and_nothing_else(tmp_path, error):
    place = tmp_path / "place"
    place.write_text("old")

    def break_off() -> None:
        with written_whole(place) as partial:
            partial.write_text("half")
            raise error

    with pytest.raises(error):
        break_off()
    assert place.read_text() == "old"
    assert listed(tmp_path) == {"place"}


def test_what_an_earlier_run_left_half_written_is_no_obstacle(tmp_path):
    (tmp_path / "place.partial").write_text("half")
    check_output(tmp_path / "place")
    write_whole(tmp_path / "place", "whole")
    assert listed(tmp_path) == {"place"}


@contextmanager
def files_of_at_most(n_bytes: int) -> Iterator[None]:
    """Writing more fails as on a full disk, only by another number (setrlimit(2), EFBIG)."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_disk_that_fills_up_leaves_the_old_file_and_nothing_else(tmp_path):
    place = tmp_path / "place"
    place.write_text("old")
    with files_of_at_most(1000), pytest.raises(OutputError, match="written: File too large"):
        write_whole(place, "much" * 1000)
    assert place.read_text() == "old"
    assert listed(tmp_path) == {"place"}


@pytest.mark.parametrize(
    ("n_letters", "said"),
    [
        (20_000, r"the trace stopped: File too large"),  # more than Python holds back: at once
        (2_000, r"cannot be written: File too large"),  # at the end
    ],
)
def test_a_trace_on_a_disk_that_fills_up_is_one_line_and_no_file(tmp_path, n_letters, said):
    def write() -> None:
        with TraceFile(tmp_path / "trace.jsonl", {"servos": ["x" * n_letters]}):
            pass

    with files_of_at_most(1000), pytest.raises(UserError, match=said):
        write()
    assert listed(tmp_path) == set()


def test_a_full_disk_is_named_in_one_line(tmp_path, monkeypatch):
    """Every sync fails as it does where no space is left."""

    def full(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OutputError, match="cannot be written: No space left on device"):
        write_whole(tmp_path / "place", "much")
    assert listed(tmp_path) == set()
