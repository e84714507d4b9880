"""Signals that end a program."""

import signal

from firmware_bridge.stop_signals import SignalCounter


def test_what_nohup_ignores_stays_ignored_and_what_a_script_ignores_with_an_ampersand_does_not():
    previous = {
        each: signal.signal(each, signal.SIG_IGN) for each in (signal.SIGHUP, signal.SIGINT)
    }
    try:
        with SignalCounter() as counted:
            signal.raise_signal(signal.SIGHUP)
            assert counted.count == 0
            signal.raise_signal(signal.SIGINT)
            assert counted.count == 1
    finally:
        for each, handler in previous.items():
            signal.signal(each, handler)
