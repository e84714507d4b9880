"""Signals that end a program."""

import signal

from firmware_bridge.stop_signals import SignalCounter


def test_what_nohup_ignores_stays_ignored():
    previous = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with SignalCounter() as counted:
            signal.raise_signal(signal.SIGHUP)
            assert counted.count == 0
            signal.raise_signal(signal.SIGTERM)
            assert counted.count == 1
    finally:
        signal.signal(signal.SIGHUP, previous)
