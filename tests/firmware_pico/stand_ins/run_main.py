"""Runs the firmware's main.py; what CPython lacks is put in its place."""

import sys
import time

firmware = sys.argv[1]
sys.path.insert(0, firmware)
sys.path.insert(0, __file__.rsplit("/", 1)[0])

if sys.implementation.name == "cpython":
    from io import FileIO
    from types import SimpleNamespace

    time.ticks_ms = lambda: time.monotonic_ns() // 1_000_000
    time.ticks_diff = lambda now, before: now - before
    raw = FileIO(0)
    sys.stdin = SimpleNamespace(buffer=raw, fileno=raw.fileno)
    sys.stdout = SimpleNamespace(buffer=FileIO(1, "w"), flush=lambda: None)

import machine  # noqa: E402

sys.modules["micropython"] = machine.Interrupts()

import main  # noqa: E402, F401
