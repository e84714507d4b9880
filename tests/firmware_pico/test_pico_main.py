"""The Pico's whole firmware in its interpreter, with stand-ins for board and USB port.

MicroPython where it is installed (Debian: micropython), and CPython everywhere.
"""

import contextlib
import json
import os
import select
import shutil
import subprocess
import sys
import time
import tty
from pathlib import Path

import pytest
from hobby_bus import on_maestro
from places import ROOT

from firmware_bridge.bus_kinds import bus_kind
from lipservo.settings.settings import load_shipped_face

# Real processes in real time.
pytestmark = pytest.mark.slow

STAND_INS = Path(__file__).with_name("stand_ins")
FIRMWARE = ROOT / "firmware" / "pico_maestro"
PINS = list(range(2, 14))
PATIENCE_S = 20.0


@pytest.fixture(params=["micropython", "cpython"])
def interpreter(request):
    if request.param == "cpython":
        return [sys.executable, "-B"]
    found = shutil.which("micropython")
    if found is None:
        pytest.skip("micropython is not installed (Debian: micropython, from 13 on)")
    return [found]


class Board:
    """A Pico that is powered: what its pins send, and bytes to and from its USB port."""

    def __init__(self, process, log, port):
        self.process, self._log, self.port = process, log, port

    def rows(self):
        text = self._log.read_text() if self._log.exists() else ""
        return [json.loads(line) for line in text.splitlines(keepends=True) if line.endswith("\n")]

    def pulses_us(self):
        """The last of each pin."""
        return {pin: rest[-1] / 1e3 for pin, *rest in self.rows() if pin != "chip"}

    def tell(self, text):
        os.write(self.port, bytes.fromhex(text))

    def answer(self, n_bytes):
        said = b""
        while len(said) < n_bytes and select.select([self.port], [], [], PATIENCE_S)[0]:
            said += os.read(self.port, n_bytes - len(said))
        return said

    def wait_for(self, condition):
        end = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < end, (self.process.poll(), self.rows()[-5:])
            time.sleep(0.01)


@contextlib.contextmanager
def powered(interpreter, folder, grounded=""):
    log = folder / "pulses.jsonl"
    board_side, port = os.openpty()
    tty.setraw(port)
    process = subprocess.Popen(
        [*interpreter, str(STAND_INS / "run_main.py"), str(FIRMWARE)],
        stdin=board_side,
        stdout=board_side,
        env=os.environ | {"PULSES": str(log), "GROUNDED": grounded},
    )
    os.close(board_side)
    board = Board(process, log, port)
    try:
        if not grounded:
            board.wait_for(lambda: ["chip", "watchdog", 2000] in board.rows())
        yield board
    finally:
        process.kill()
        process.wait(PATIENCE_S)
        os.close(port)


def test_pulses_start_with_a_command_and_stop_with_silence(interpreter, tmp_path):
    with powered(interpreter, tmp_path) as board:
        assert ["chip", "Ctrl-C", -1] in board.rows()
        assert board.pulses_us() == dict.fromkeys(PINS, 0.0)
        assert {row[1] for row in board.rows() if row[0] != "chip"} == {50}

        # Channel 3, whose number is Ctrl-C, and the last; then too much and too little.
        board.tell("a1 84 03 70 2e 84 0b 00 3e 84 00 7f 7f 84 01 01 00 90 03")
        assert board.answer(4)[2:] == b"\x70\x17"
        sent = board.pulses_us()
        assert [sent[pin] for pin in (5, 13, 2, 3)] == [1500.0, 1984.0, 2500.0, 500.0]

        began_s = time.monotonic()
        board.wait_for(lambda: not any(board.pulses_us().values()))
        assert time.monotonic() - began_s > 0.3
        board.tell("a1 a1")
        assert board.answer(4) == b"\x20\0\0\0"
        board.tell("84 00 70 2e")
        board.wait_for(lambda: board.pulses_us()[2] == 1500.0)
        board.tell("84 00")
        board.tell("a2")
        board.wait_for(lambda: board.pulses_us()[2] == 0.0)
        board.tell("a1")
        assert board.answer(2) == b"\x10\0"


def test_bytes_without_end_for_another_keep_no_pulse_alive(interpreter, tmp_path):
    with powered(interpreter, tmp_path) as board:
        board.tell("84 00 70 2e")
        board.wait_for(lambda: board.pulses_us()[2] == 1500.0)
        end = time.monotonic() + PATIENCE_S
        while board.pulses_us()[2]:
            assert time.monotonic() < end
            if select.select([], [board.port], [], 0.01)[1]:
                board.tell("aa 03 04 00 70 2e" * 100)


def test_a_program_that_raises_leaves_no_pulses(interpreter, tmp_path):
    with powered(interpreter, tmp_path) as board:
        board.tell("9f 02 00 70 2e 70 2e")
        board.wait_for(lambda: board.pulses_us()[3] == 1500.0)
        (tmp_path / "pulses.jsonl.raise").touch()
        board.process.wait(PATIENCE_S)
        assert not any(board.pulses_us().values())


def test_a_pin_to_ground_gives_the_prompt(interpreter, tmp_path):
    with powered(interpreter, tmp_path, grounded="22") as board:
        assert board.process.wait(PATIENCE_S) == 0
        assert board.rows() == []


def test_the_doctor_finds_it_and_its_timeout(interpreter, tmp_path):
    with powered(interpreter, tmp_path) as board:
        name = os.ttyname(board.port)
        wiring = on_maestro(load_shipped_face("face_jaw"), port=name, model="pico")
        # On a busy computer the board's own process may sleep through its half second.
        for _ in range(5):
            found = [each.what for each in bus_kind("maestro").examine(wiring)]
            if "by itself" in found[-1]:
                break

        assert found[0] == f"a Maestro answers at {name}"
        assert "gets no pulses" in found[1]
        assert found[-1] == "it stops its pulses by itself after 0.5 s"
