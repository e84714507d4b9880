"""A PulseAudio server of the test's own with one null sink: real PortAudio, no sound card.

PortAudio reaches it through ALSA's pulse plugin; the sink's monitor is the default microphone. What
plays or listens must be a process of its own: the environment counts when PortAudio starts.
"""

import contextlib
import os
import shutil
import subprocess
import time
from pathlib import Path

import pytest
from places import short_folder

_ALSA = "</usr/share/alsa/alsa.conf>\npcm.!default { type pulse }\nctl.!default { type pulse }\n"
_PLUGINS = ("/usr/lib", "/usr/lib64")
_PATIENCE_S = 20.0


def _missing():
    """What of the Debian packages is not installed; None: nothing."""
    for program, package in (("pulseaudio", "pulseaudio"), ("pactl", "pulseaudio-utils")):
        if shutil.which(program) is None:
            return f"no {program}: apt install {package}"
    plugin = "libasound_module_pcm_pulse.so"
    found = (
        next(Path(folder).glob(f"**/alsa-lib/{plugin}"), None)
        for folder in _PLUGINS
        if Path(folder).is_dir()
    )
    if not any(found):
        return "no ALSA plugin for PulseAudio: apt install libasound2-plugins"
    try:
        import sounddevice  # noqa: F401 - whether PortAudio is there
    except OSError:
        return "no PortAudio: apt install libportaudio2"
    return None


class NullSink:
    """The server; `environment` is for processes that are to hear and play there."""

    def __init__(self, folder):
        self.folder = folder
        self.socket = folder / "native"
        self.process = None
        (folder / "asound.conf").write_text(_ALSA)
        (folder / "server.pa").write_text(
            f"load-module module-native-protocol-unix socket={self.socket} auth-anonymous=1\n"
            "load-module module-null-sink sink_name=speaker rate=48000\n"
            "set-default-sink speaker\nset-default-source speaker.monitor\n"
        )
        self.environment = {
            **os.environ,
            "HOME": str(folder),
            "XDG_RUNTIME_DIR": str(folder),
            "PULSE_SERVER": f"unix:{self.socket}",
            "PULSE_COOKIE": str(folder / "cookie"),
            "ALSA_CONFIG_PATH": str(folder / "asound.conf"),
        }

    def start(self):
        with (self.folder / "server.log").open("w") as log:
            self.process = subprocess.Popen(
                [
                    *("pulseaudio", "-n", "-F", str(self.folder / "server.pa"), "--daemonize=no"),
                    *("--exit-idle-time=-1", "--disable-shm=yes", "--use-pid-file=no"),
                    *("--realtime=no", "--high-priority=no", "--log-target=stderr"),
                ],
                env={**self.environment, "PULSE_SERVER": ""},
                stdout=subprocess.DEVNULL,
                stderr=log,
            )
        deadline_s = time.monotonic() + _PATIENCE_S
        asked = ["pactl", "list", "short", "sources"]
        while time.monotonic() < deadline_s and self.process.poll() is None:
            told = subprocess.run(asked, env=self.environment, capture_output=True, check=False)
            if b"speaker.monitor" in told.stdout:
                return
            time.sleep(0.05)
        pytest.skip(f"PulseAudio does not start: {(self.folder / 'server.log').read_text()}")

    def stop(self):
        self.process.terminate()
        self.process.wait()


@contextlib.contextmanager
def null_sink():
    """A running one; skips with a reason where what it needs is not installed."""
    reason = _missing()
    if reason is not None:
        pytest.skip(reason)
    server = NullSink(short_folder())
    server.start()
    try:
        yield server
    finally:
        server.stop()
