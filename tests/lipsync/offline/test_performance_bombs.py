"""Performances made to fill the memory of the face that reads them: refused in one line, by size.

They are read in a process of their own, whose peak of memory is what the system says of it: VmHWM,
which begins anew with each file, because `getrusage` counts what the parent had when it forked.
"""

import hashlib
import io
import json
import subprocess
import sys
from zipfile import ZIP_DEFLATED, ZIP_LZMA, ZipFile

import numpy as np
import pytest
import soundfile
from written_performance import written_performance

MOST_MB = 100.0
PLAIN = {"descr": "<f4", "fortran_order": False}
#: What a face does with a file that it is to play, but for saying it.
READ = """
import json, sys
from pathlib import Path
from lipservo.runtime.speech.performed_line import performed_line
from lipsync.offline.performance import read_performance
for name in sys.stdin:
    path, message = Path(json.loads(name)), ""
    Path("/proc/self/clear_refs").write_text("5")
    try:
        line = performed_line(read_performance(path), path)
        n_samples = sum(len(chunk) for chunk in line.chunks())
    except ValueError as error:
        message = str(error)
    except BaseException as error:
        message = f"fault: {error!r}"
    status = Path("/proc/self/status").read_text()
    peak_mb = int(status.split("VmHWM:")[1].split()[0]) / 1024
    print(json.dumps([message, peak_mb]), flush=True)
"""
READERS = []


@pytest.fixture(scope="module", autouse=True)
def reader():
    with subprocess.Popen(
        [sys.executable, "-c", READ], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        READERS.append(process)
        yield
        process.stdin.close()


def read(path):
    """What was said of the file, and the peak of memory in MB."""
    READERS[-1].stdin.write(json.dumps(str(path)) + "\n")
    READERS[-1].stdin.flush()
    message, peak_mb = json.loads(READERS[-1].stdout.readline())
    return message, peak_mb


def refused(path):
    message, peak_mb = read(path)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    assert peak_mb <= MOST_MB
    return message


def header(shape, **changes):
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {**PLAIN, "shape": shape, **changes})
    return file.getvalue()


@pytest.fixture
def rewritten(tmp_path):
    """Return a function that writes a performance with some members replaced and returns its path.

    members: by name, an iterator of bytes or None for none; packing: of these members.
    """
    whole = written_performance(tmp_path / "whole.perf", 0.3)

    def write(packing=ZIP_DEFLATED, **members):
        path = tmp_path / "bomb.perf"
        with ZipFile(whole) as old, ZipFile(path, "w", ZIP_DEFLATED) as new:
            for name in old.namelist():
                if name.removesuffix(".npy") not in members:
                    new.writestr(name, old.read(name))
            for name, chunks in members.items():
                new.compression = packing
                with new.open(f"{name}.npy", "w", force_zip64=True) as file:
                    for chunk in chunks:
                        file.write(chunk)
        return path

    return write


def about(tmp_path, **changes):
    with np.load(tmp_path / "whole.perf") as archive:
        return {**json.loads(archive["about"].tobytes()), **changes}


def as_bytes(n_bytes, chunks):
    yield header((n_bytes,), descr="|u1")
    yield from chunks


def zeros(n_bytes):
    return (bytes(1_000_000) for _ in range(n_bytes // 1_000_000))


@pytest.mark.parametrize(
    ("rows", "n_bytes", "why"),
    [(22_500_000, 450_000_000, "unpacked; at most"), (100_000, 2_000_000, "more than 10 minutes")],
)
def test_zeros_that_are_too_many_faces(rewritten, rows, n_bytes, why):
    assert why in refused(rewritten(coefficients=[header((rows, 5)), *zeros(n_bytes)]))


def test_a_header_that_nests_without_end(rewritten):
    text = b'{"kind": ' + b"[" * 1_000_000
    assert "damaged" in refused(rewritten(about=as_bytes(len(text), [text])))


def test_an_archive_in_an_archive_and_one_that_takes_gigabytes_to_unpack(rewritten, tmp_path):
    inner = (tmp_path / "whole.perf").read_bytes()
    assert "'coefficients' has no plain numbers" in refused(rewritten(coefficients=[inner]))
    path = rewritten(ZIP_LZMA, coefficients=[header((2, 5)), bytes(40)])
    assert "compressed in a way" in refused(path)


def test_phonemes(rewritten, tmp_path):
    row = b'["AA",0.0,0.1],' * 10_000
    text = json.dumps(about(tmp_path, phonemes="HERE")).encode().replace(b'"HERE"', b"[%s]")
    before, after = text.split(b"%s")
    n_bytes = len(before) + 400 * len(row) + 14 + len(after)
    chunks = as_bytes(n_bytes, [before, *[row] * 400, b'["AA",0.0,0.1]', after])
    assert "'about' is 60" in refused(rewritten(about=chunks))


@pytest.mark.parametrize("piece", [b"[],", b"{},", b"[[],1.5],", b'"\xc3\xa9\xc3\xa9",'])
def test_whatever_else_may_stand_where_phonemes_are_read(rewritten, tmp_path, piece):
    text = json.dumps(about(tmp_path, phonemes="HERE")).encode()
    before, after = text.split(b'"HERE"')
    n = 1_900_000 // len(piece)
    chunks = [before, b"[", piece * n, piece[:-1], b"]", after]
    size = sum(len(chunk) for chunk in chunks)
    assert "phonemes are too many for 0.3 s" in refused(rewritten(about=as_bytes(size, chunks)))


@pytest.mark.slow
def test_sound_of_zeros(rewritten, tmp_path):
    n_bytes = 119_000_000
    digest = hashlib.sha256(bytes(n_bytes)).hexdigest()
    sound = {"name": "line.wav", "sha256": digest, "included": True}
    text = json.dumps(about(tmp_path, sound=sound)).encode()
    path = rewritten(about=as_bytes(len(text), [text]), sound=as_bytes(n_bytes, zeros(n_bytes)))
    assert "its sound line.wav: not a sound file" in refused(path)
    path = rewritten(about=as_bytes(len(text), [text]), sound=as_bytes(10**9, zeros(10**9)))
    assert "unpacked; at most" in refused(path)


@pytest.mark.slow
def test_ten_minutes_are_played_without_being_held(tmp_path):
    """Not refused: it is as long as a performance may be."""
    rate_hz, duration_s = 48_000, 600
    sound = tmp_path / "long.flac"
    with soundfile.SoundFile(sound, "w", rate_hz, 2) as file:
        hum = 0.1 * np.sin(np.arange(rate_hz) / 50.0).repeat(2).reshape(-1, 2)
        for _ in range(duration_s):
            file.write(hum)
    whole = written_performance(tmp_path / "long.perf", duration_s, sound=sound)
    message, peak_mb = read(whole)
    assert message == ""
    assert peak_mb <= MOST_MB


def test_a_list_of_many_members_and_one_for_archives_above_4_gb(rewritten, tmp_path):
    path = tmp_path / "many.perf"
    with ZipFile(path, "w") as file:
        for number in range(30_000):
            file.writestr(f"{number}.npy", b"")
    assert "list of arrays is too long" in refused(path)
    path = rewritten()
    whole = path.read_bytes()
    path.write_bytes(whole[:-22] + b"PK\x06\x07" + bytes(16) + whole[-22:])
    assert "list of arrays is too long" in refused(path)


@pytest.mark.parametrize(
    ("lie", "why"),
    [
        (header((10**9, 5)), "bytes for"),
        (header((10**11, 10**11)), "bytes for"),
        (header((0, 10**11)), "shape"),
        (header((10**11,), descr="<U0"), "bytes for"),
        (header((1,), descr="|O"), "no plain numbers"),
        (header((1,), descr=[("a", "<f4")]), "no plain numbers"),
        (header(()), "bytes for"),
        (b"\x93NUMPY\x02\x00\xff\xff\xff\xff", "no plain numbers"),
        (b"\x93NUMPY\x01\x00\xff\xff" + b"(" * 65_535, "no plain numbers"),
        (b"\x93NUMPY\x01\x00\x40\x00" + b"{'descr': '<f4', 'shape': (" + b"9" * 37, "no plain"),
        (b"", "no plain numbers"),
    ],
)
def test_headers_that_lie(rewritten, lie, why):
    message = refused(rewritten(coefficients=[lie]))
    assert why in message
    assert "pickle" not in message


@pytest.mark.parametrize("n_bytes", [0xF0000000, 5_000_000, 100])
def test_a_list_that_lies_about_the_size_of_a_member(rewritten, n_bytes):
    path = rewritten(coefficients=[header((1_000, 5)), bytes(20_000)])
    whole = bytearray(path.read_bytes())
    place = whole.rindex(b"PK\x01\x02")  # the last member is the one that was written last
    whole[place + 24 : place + 28] = n_bytes.to_bytes(4, "little")
    path.write_bytes(whole)
    assert "damaged" in refused(path)


@pytest.mark.parametrize("kept", [0.0, 0.3, 0.9, 0.999])
def test_truncated(rewritten, kept):
    path = rewritten()
    whole = path.read_bytes()
    path.write_bytes(whole[: int(kept * len(whole))])
    assert "damaged or not a performance" in refused(path)
