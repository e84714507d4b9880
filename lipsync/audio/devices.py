"""Sound devices through PortAudio: list them, open one, and reopen a lost one.

sounddevice is imported only when a device is used: a robot that plays files to a face without a
loudspeaker needs no PortAudio.

A lost device is reopened by name, in a thread of its own: the code that plays or records never
waits for it.
"""

import contextlib
import ctypes
import re
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from types import ModuleType
from typing import Final, Literal, Protocol

from lipsync.audio.source import SoundError

Direction = Literal["input", "output"]
#: What people call a device of each direction.
_WORD: Final[dict[Direction, str]] = {"input": "microphone", "output": "loudspeaker"}
#: ALSA's number of card and device, which changes with the order in which things are plugged in.
_CARD_NUMBER: Final = re.compile(r"\s*\(hw:\d+,\d+\)$")


@dataclass(frozen=True, slots=True)
class SoundDevice:
    """A microphone or loudspeaker known to PortAudio; `sample_rate_hz` is its preferred rate.

    index: PortAudio's number for it. n_channels: the most channels that it has in the direction of
    use. is_default: whether the system uses it where none is named.
    """

    index: int
    name: str
    n_channels: int
    sample_rate_hz: int
    is_default: bool

    @property
    def lasting_name(self) -> str:
        """The device's name without ALSA's card number, unchanged by plugging it in again."""
        return _CARD_NUMBER.sub("", self.name)


class OpenStream(Protocol):
    """The part of a `sounddevice` stream's interface that this package uses."""

    @property
    def active(self) -> bool:
        """Whether the stream is running, so that its callback is being called."""

    @property
    def latency(self) -> float:
        """The latency in seconds that the device reports when it is opened."""

    @property
    def time(self) -> float:
        """The time in seconds now, on the clock of the stream's time stamps."""

    def start(self) -> None:
        """Start the stream, so that its callback is called."""

    def abort(self) -> None:
        """End the stream at once, without playing what is buffered; errors are ignored."""

    def close(self) -> None:
        """Close the stream and free its device; errors are ignored."""


def import_sounddevice() -> ModuleType:
    """Return the sounddevice module. Raises SoundError if it or PortAudio's library is missing."""
    try:
        import sounddevice
    except ImportError as error:
        raise SoundError(
            "no sounddevice package, which sound needs: `pip install sounddevice`"
        ) from error
    except OSError as error:  # what it raises when the library is not found
        raise SoundError(
            "no PortAudio library, which sound needs: `apt install libportaudio2`"
        ) from error
    quiet_alsa()
    module: ModuleType = sounddevice
    return module


def quiet_alsa() -> None:
    """Stop ALSA from printing: a slow computer would fill a log with its lines on underruns.

    Underruns are counted by the flags of each callback, and a device that cannot be opened is a
    SoundError. ALSA calls its handler in the thread that plays, which must not wait for Python or a
    terminal: so `abs` of the C library, which does nothing, is the handler. Without ALSA nothing
    happens.
    """
    with contextlib.suppress(OSError, AttributeError):
        nothing = ctypes.cast(ctypes.CDLL(None).abs, ctypes.c_void_p)
        ctypes.CDLL("libasound.so.2").snd_lib_error_set_handler(nothing)


def sound_devices(direction: Direction) -> tuple[SoundDevice, ...]:
    """Return all devices with a channel in `direction`. Raises SoundError without PortAudio."""
    sounddevice = import_sounddevice()
    default_index = sounddevice.default.device[0 if direction == "input" else 1]
    channels = f"max_{direction}_channels"
    return tuple(
        SoundDevice(
            index=index,
            name=str(device["name"]),
            n_channels=int(device[channels]),
            sample_rate_hz=round(device["default_samplerate"]),
            is_default=index == default_index,
        )
        for index, device in enumerate(sounddevice.query_devices())
        if device[channels] > 0
    )


def find_device(wanted: str | int | None, direction: Direction) -> SoundDevice:
    """Return the device whose number or name is `wanted`, or the only one whose name contains it.

    wanted: None for the system's default. Raises SoundError, which lists the devices, if none or
    several match.
    """
    sounddevice = import_sounddevice()
    devices = sound_devices(direction)
    word = _WORD[direction]
    if not devices:
        otherwise = (
            "play a file instead" if direction == "input" else "leave out --play (`say`: --mute)"
        )
        raise SoundError(f"no {word}: plug one in, or {otherwise}")
    # A shell hands an index over as text.
    key = int(wanted) if wanted is not None and is_number(wanted) else wanted
    try:
        index = sounddevice.query_devices(key, direction)["index"]
        return next(device for device in devices if device.index == index)
    except (ValueError, StopIteration, sounddevice.PortAudioError) as error:
        device_list = "; ".join(f"{device.index} {device.name}" for device in devices)
        what = f"no default {word}" if wanted is None else f"no single {word} {wanted!r}"
        raise SoundError(f"{what}; name one of: {device_list}") from error


def is_number(device: str | int | None) -> bool:
    """Return whether `device` is a number, which may be another device's after plugging."""
    return isinstance(device, int) or (device is not None and device.isdecimal())


def offset_ms_of(device: str, offsets_ms: Mapping[str, float]) -> float:
    """Return the configured ms by which the sound of `device` is heard later than it reports.

    device: its full name; offsets_ms: by name. The longest name counts that is the device's name or
    part of it; 0 if there is none.
    """
    named = [name for name in offsets_ms if name in device]
    return offsets_ms[max(named, key=len)] if named else 0.0


class _OpenStreams:
    """The number of streams that this program has open: above 0 PortAudio must not be restarted."""

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self.n_open = 0


_STREAMS: Final = _OpenStreams()


@contextmanager
def portaudio_lock() -> Iterator[None]:
    """Lock PortAudio while a device is found and its stream made and started: one thread at a time.

    Meanwhile no other thread restarts PortAudio, which would end a stream that is not counted yet.
    """
    with _STREAMS.lock:
        yield


def start_stream(stream: OpenStream) -> None:
    """Start a stream made within `portaudio_lock`, and count it as open; close it on failure.

    Raises PortAudioError. The call waits for the device: never make it in the live loop.
    """
    with _STREAMS.lock:
        _STREAMS.n_open += 1
    try:
        stream.start()
    except BaseException:
        close_stream(stream)
        raise


def close_stream(stream: OpenStream) -> None:
    """Close and uncount a started stream, even of a lost device; never call it in the live loop."""
    try:
        stream.abort()  # a device that is gone would be waited for until its buffers have drained
        stream.close()
    finally:
        with _STREAMS.lock:
            _STREAMS.n_open -= 1


def restart_portaudio() -> bool:
    """Restart PortAudio so that it lists the devices again; return whether it was restarted.

    A restart ends every open stream of this program: while any is open, nothing is done. Raises
    PortAudioError if it does not start; the next call tries again.
    """
    sounddevice = import_sounddevice()
    with _STREAMS.lock:
        if _STREAMS.n_open:
            return False
        # sounddevice has no public name for it; its documentation says to use these two.
        with contextlib.suppress(sounddevice.PortAudioError):  # it had not started the last time
            sounddevice._terminate()
        sounddevice._initialize()
    return True


#: A device whose callback was not called for so long is lost.
SILENT_S: Final = 0.5
#: But not so soon after it was opened: a PulseAudio sink that slept took 1.1 s to begin.
SETTLING_S: Final = 3.0
#: Time between two tries to reopen a lost device.
RETRY_S: Final = 1.0
#: Time between two checks for a loss.
CHECK_S: Final = 0.1


class DeviceWatch:
    """A watch that keeps one stream open: it notices when the device is lost, and reopens it.

    `open_stream` finds the device by the names that exist now and starts a stream of it; it raises
    SoundError where that cannot be done. The stream's callback reports each of its calls to
    `note_call`. clock: returns monotonic seconds.
    """

    def __init__(self, open_stream: Callable[[], OpenStream], clock: Callable[[], float]) -> None:
        """Store how to open a stream, as the class says; nothing is opened before `open`."""
        self._open_stream = open_stream
        self._clock = clock
        self._opened_s = self._tried_s = self._called_s = clock()
        self._stream: OpenStream | None = None
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None
        self._n_losses = 0

    @property
    def is_lost(self) -> bool:
        """Whether no stream is open: the device was lost, or never opened."""
        return self._stream is None

    @property
    def n_losses(self) -> int:
        """The number of times that the device was lost so far."""
        return self._n_losses

    @property
    def stream(self) -> OpenStream | None:
        """The open stream; None while the device is lost."""
        return self._stream

    def open(self) -> None:
        """Open the device for the first time, in the caller's thread. Raises SoundError."""
        with portaudio_lock():
            self._start()

    def start(self) -> None:
        """Start a thread that calls `check`, the check for a loss, every 0.1 s until `close`."""
        self._ending.clear()
        self._thread = threading.Thread(target=self._run, name="sound device", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop the watching thread and close the stream; waits for an opening that is under way."""
        self._ending.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        self._close()

    def note_call(self, now_s: float) -> None:
        """Record that the callback was called at monotonic `now_s`. Any thread; never waits."""
        self._called_s = now_s

    def check(self) -> None:
        """Close the stream if its device is lost; try to reopen a lost one, once a second."""
        now_s = self._clock()
        stream = self._stream
        if stream is not None and self._has_stopped(stream, now_s):
            self._n_losses += 1
            self._close()
        if self._stream is None and now_s - self._tried_s >= RETRY_S:
            self._tried_s = now_s
            failures = SoundError, import_sounddevice().PortAudioError
            with portaudio_lock(), contextlib.suppress(*failures):  # the next try may do better
                restart_portaudio()
                self._start()

    def _has_stopped(self, stream: OpenStream, now_s: float) -> bool:
        """Return whether the stream ended, or its callback was not called for 0.5 s."""
        is_settled = now_s - self._opened_s > SETTLING_S
        return not stream.active or (is_settled and now_s - self._called_s > SILENT_S)

    def _start(self) -> None:
        """Open the stream, and note when. Raises SoundError, and PortAudioError from its lists."""
        stream = self._open_stream()
        self._opened_s = self._tried_s = self._called_s = self._clock()
        self._stream = stream

    def _close(self) -> None:
        stream, self._stream = self._stream, None
        if stream is not None:
            close_stream(stream)

    def _run(self) -> None:
        while not self._ending.wait(CHECK_S):
            self.check()
