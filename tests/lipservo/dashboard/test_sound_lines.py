"""Sound files of a face: stored whole and known to be sound, by names that lead nowhere else."""

import asyncio
import os
import threading

import numpy as np
import pytest
import soundfile
from hypothesis import given
from hypothesis import strategies as st
from lipservo_client.protocol import FaceError
from written_performance import written_performance

from lipservo.dashboard import sound_lines as uploads
from lipservo.dashboard.sound_lines import MOST_AT_ONCE, SoundLines, Uploads, checked_name


@pytest.fixture
def sound(tmp_path):
    path = tmp_path / "sound.wav"
    soundfile.write(path, 0.1 * np.sin(np.arange(16_000)), 16_000)
    return path.read_bytes()


@pytest.fixture
def folder(tmp_path):
    made = tmp_path / "sounds"
    made.mkdir()
    return made


def stored(folder, name, content, **options):
    async def chunks():
        for first in range(0, len(content), 4096):
            yield content[first : first + 4096]

    return asyncio.run(Uploads().store(SoundLines(folder).target_path(name), chunks(), **options))


def refused(code, do, *arguments, **options):
    with pytest.raises(FaceError) as raised:
        do(*arguments, **options)
    assert raised.value.code == code
    assert len(str(raised.value).splitlines()) == 1
    return str(raised.value)


@pytest.mark.parametrize("name", ["a.wav", "Hello there.flac", "größe 2.ogg", "日本.WAV"])
def test_plain_names_will_do(name):
    assert checked_name(name) == name


@pytest.mark.parametrize(
    "name",
    [
        "", ".wav", "..", "../a.wav", "/a.wav", "a/b.wav", "a\\b.wav", "a\0.wav", ".hidden.wav",
        "a.wav\n", "a\tb.wav", "C:a.wav", "a.wav ", " a.wav", "-rf.wav", "a.wav.", "a", "a.txt",
        "a.wav.exe", "a" * 300 + ".wav", "é" * 150 + ".wav", "a\u202egnp.wav", "a\u200b.wav",
        "\ud800.wav", "%2e%2e/a.wav", "a?.wav", "..\\a.wav", ".coming-a.wav", "~/a.wav",
    ],
)  # fmt: skip
def test_tricks_with_names_are_refused(name):
    refused("refused", checked_name, name)


@given(st.text(max_size=60).map(lambda text: text + ".wav"))
def test_whatever_is_let_through_is_a_file_of_the_folder_itself(tmp_path_factory, name):
    try:
        checked_name(name)
    except FaceError:
        return
    folder = tmp_path_factory.getbasetemp()
    assert (folder / name).resolve().parent == folder.resolve()


def test_a_file_is_stored_listed_and_removed(folder, sound):
    assert stored(folder, "hello.wav", sound) == {"name": "hello.wav", "n_bytes": len(sound)}
    (line,) = SoundLines(folder).listed()
    assert (line["name"], line["n_bytes"]) == ("hello.wav", len(sound))
    assert (folder / "hello.wav").read_bytes() == sound

    SoundLines(folder).remove("hello.wav")
    assert SoundLines(folder).listed() == []
    refused("not_found", SoundLines(folder).remove, "hello.wav")


def test_what_is_there_stays_unless_it_is_to_be_replaced(folder, sound):
    (folder / "hello.wav").write_bytes(b"mine")
    refused("exists", stored, folder, "hello.wav", sound)
    assert (folder / "hello.wav").read_bytes() == b"mine"
    stored(folder, "hello.wav", sound, replace=True)
    assert (folder / "hello.wav").read_bytes() == sound


@pytest.mark.parametrize("content", [b"", b"no sound at all", b"RIFF\0\0\0\0WAVE"])
def test_what_is_no_sound_is_not_kept(folder, content):
    assert "hello.wav" in refused("not_sound", stored, folder, "hello.wav", content)
    assert list(folder.iterdir()) == []


def test_what_is_too_large_is_not_kept(folder, sound, monkeypatch):
    monkeypatch.setattr(uploads, "MOST_BYTES", len(sound) - 1)
    refused("too_large", stored, folder, "hello.wav", sound)
    assert list(folder.iterdir()) == []


def test_an_upload_that_breaks_off_leaves_nothing(folder, sound):
    async def broken():
        yield sound[:1000]
        raise ConnectionError("gone")

    with pytest.raises((ConnectionError, FaceError)):
        asyncio.run(Uploads().store(folder / "hello.wav", broken()))
    assert list(folder.iterdir()) == []


def test_a_client_that_sends_too_slowly_is_given_up_and_leaves_nothing(folder, sound, monkeypatch):
    monkeypatch.setattr(uploads, "_STALLED_S", 0.05)

    async def stalled():
        yield sound[:1000]
        await asyncio.sleep(60.0)

    with pytest.raises(FaceError) as raised:
        asyncio.run(Uploads().store(folder / "hello.wav", stalled()))
    assert raised.value.code == "stalled"
    assert list(folder.iterdir()) == []


def test_a_few_uploads_come_in_at_a_time_and_one_more_is_refused(folder, sound):
    async def crowd():
        coming, go_on = Uploads(), asyncio.Event()

        async def chunks():
            await go_on.wait()
            yield sound

        first = [
            asyncio.ensure_future(coming.store(folder / f"{n}.wav", chunks()))
            for n in range(MOST_AT_ONCE)
        ]
        await asyncio.sleep(0)
        with pytest.raises(FaceError) as raised:
            await coming.store(folder / "more.wav", chunks())
        go_on.set()
        await asyncio.gather(*first)
        await coming.store(folder / "more.wav", chunks())
        return raised.value.code

    assert asyncio.run(crowd()) == "busy"
    assert len(list(folder.iterdir())) == MOST_AT_ONCE + 1


def test_what_a_killed_dashboard_left_is_removed_at_a_later_upload(folder, sound):
    old, new = folder / ".coming-old.wav", folder / ".coming-new.wav"
    for path in (old, new):
        path.write_bytes(b"half")
    os.utime(old, (0, 0))
    stored(folder, "hello.wav", sound)
    assert sorted(path.name for path in folder.iterdir()) == [".coming-new.wav", "hello.wav"]


def test_a_server_that_ends_waits_for_no_disk(folder, sound, monkeypatch):
    """Its tasks are cancelled: one line for the client; nothing is left once the disk is done."""
    in_fsync, go_on = threading.Event(), threading.Event()
    monkeypatch.setattr(uploads.os, "fsync", lambda _fd: in_fsync.set() or go_on.wait(60.0))

    async def ended():
        async def chunks():
            yield sound

        storing = asyncio.ensure_future(Uploads().store(folder / "hello.wav", chunks()))
        await asyncio.to_thread(in_fsync.wait, 60.0)
        storing.cancel()
        with pytest.raises(FaceError, match="the dashboard is ending"):
            await storing
        go_on.set()
        while any(path.name.startswith(".coming-") for path in folder.iterdir()):
            await asyncio.sleep(0.01)

    asyncio.run(ended())


def test_the_event_loop_goes_on_while_a_disk_is_slow(folder, sound, monkeypatch):
    """A card takes seconds for one fsync; here it takes as long as the loop needs."""
    loop_went_on = threading.Event()
    monkeypatch.setattr(uploads.os, "fsync", lambda _fd: loop_went_on.wait(60.0) or 1 / 0)

    async def upload():
        async def chunks():
            yield sound

        storing = asyncio.ensure_future(Uploads().store(folder / "hello.wav", chunks()))
        while not any(path.stat().st_size for path in folder.iterdir()):
            await asyncio.sleep(0.01)
        loop_went_on.set()
        return await storing

    assert asyncio.run(upload())["n_bytes"] == len(sound)


def test_links_and_folders_are_no_lines(folder, tmp_path):
    (tmp_path / "secret.wav").write_bytes(b"secret")
    (folder / "link.wav").symlink_to(tmp_path / "secret.wav")
    (folder / "folder.wav").mkdir()

    lines = SoundLines(folder)
    assert lines.listed() == []
    for name in ("link.wav", "folder.wav"):
        refused("not_found", lines.existing_path, name)
        refused("not_found", lines.remove, name)
    assert (tmp_path / "secret.wav").exists()


def test_a_face_without_a_folder_plays_no_files(tmp_path, sound):
    for do in (SoundLines(None).listed, lambda: stored(None, "a.wav", sound)):
        assert "--sounds" in refused("not_available", do)
    refused("not_available", stored, tmp_path / "nowhere", "a.wav", sound)


def test_a_performance_is_a_line_like_a_sound_and_a_damaged_one_is_refused(folder, tmp_path):
    content = written_performance(tmp_path / "hello.perf", 0.2).read_bytes()
    stored(folder, "hello.perf", content)

    assert [line["name"] for line in SoundLines(folder).listed()] == ["hello.perf"]
    assert SoundLines(folder).existing_path("hello.perf").read_bytes() == content
    told = refused("not_sound", stored, folder, "cut.perf", content[:-300])
    assert told.startswith("cut.perf: damaged")
    assert [path.name for path in folder.iterdir()] == ["hello.perf"]
