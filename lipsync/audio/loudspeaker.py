"""A loudspeaker through PortAudio: it plays a timeline and reports which position is heard when.

Samples wait in a ring between the live loop, which writes them, and the device, which reads them.
Neither waits for the other and neither needs a lock: each counts its samples in a number that no
other thread changes, and all counts are of the timeline's samples, from the first ever written.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from lipsync.audio.devices import (
    DeviceWatch,
    OpenStream,
    SoundDevice,
    find_device,
    import_sounddevice,
    is_number,
    offset_ms_of,
    portaudio_lock,
    start_stream,
)
from lipsync.audio.source import SoundError

Samples = NDArray[np.float32]

#: Sound may be written so far before it is taken.
RING_S: Final = 2.0
#: A cut fades out within this time, so that nothing clicks.
FADE_S: Final = 0.005


class SampleRing:
    """A ring buffer of two seconds of the timeline; the oldest samples not taken in time are lost.

    The timeline stays right whatever happens: where samples were lost it continues after them, and
    where none are ready it does not advance.
    """

    def __init__(self, rate_hz: int) -> None:
        """Create an empty ring. rate_hz: samples a second, a multiple of 100."""
        self.rate_hz = rate_hz
        self._ring: Samples = np.zeros((round(RING_S * rate_hz), 1), dtype=np.float32)
        # Each number is changed by one thread only: the writer's or the taker's.
        self._n_written = 0  # the writer's
        self._n_taken = 0  # the taker's
        self._n_lost = 0  # the taker's
        self._n_underruns = 0  # the taker's
        self._is_starved = True  # the taker's: no underrun is counted before the first sample
        # Half a cosine, 1 to 0.
        turn = np.arange(round(FADE_S * rate_hz), dtype=np.float32) / round(FADE_S * rate_hz)
        self._fade: Samples = (0.5 + 0.5 * np.cos(np.pi * turn)).astype(np.float32)[:, None]

    @property
    def n_written(self) -> int:
        """The number of samples of the timeline that were written so far."""
        return self._n_written

    @property
    def n_taken(self) -> int:
        """The number of samples of the timeline that were taken or lost so far."""
        return self._n_taken

    @property
    def n_lost(self) -> int:
        """The number of samples that were overwritten before they could be taken."""
        return self._n_lost

    @property
    def n_underruns(self) -> int:
        """The number of times that sound ran out while the loudspeaker needed more."""
        return self._n_underruns

    def write(self, samples: Samples) -> None:
        """Write the next samples (n,) of the timeline; n is at most the ring's length, 2 s."""
        before_wrap, after_wrap = self._ring_views(self._n_written, self._n_written + len(samples))
        before_wrap[:, 0] = samples[: len(before_wrap)]
        after_wrap[:, 0] = samples[len(before_wrap) :]
        self._n_written += len(samples)

    def take_into(self, frames: Samples) -> int:
        """Fill `frames` (n, channels) with the next samples, the same on each channel, then with 0.

        Return how many samples of the timeline were taken.
        """
        size = len(self._ring)
        n_ready = self._n_written - self._n_taken
        if n_ready > size:
            self._n_lost += n_ready - size
            self._n_taken += n_ready - size
            n_ready = size
        n = min(n_ready, len(frames))
        before_wrap, after_wrap = self._ring_views(self._n_taken, self._n_taken + n)
        frames[: len(before_wrap)] = before_wrap
        frames[len(before_wrap) : n] = after_wrap
        frames[n:] = 0.0
        if n < len(frames) and not self._is_starved:
            self._n_underruns += 1
        self._is_starved = n < len(frames)
        self._n_taken += n
        return n

    def silence_rest(self, n_untouched: int) -> int:
        """Replace the samples not taken yet by a fade-out and zeros; the writing thread calls it.

        n_untouched: number of the next samples that stay, because the device may be reading them.
        Return the number, counted on the timeline, of the first silent sample.
        """
        oldest = max(self._n_taken, self._n_written - len(self._ring))
        first_cut = min(oldest + n_untouched, self._n_written)
        n_fade = min(len(self._fade), self._n_written - first_cut)
        # Zeros first: a taker that overtakes the fade plays silence.
        for view in self._ring_views(first_cut + n_fade, self._n_written):
            view[:] = 0.0
        n_faded = 0
        for view in self._ring_views(first_cut, first_cut + n_fade):
            view *= self._fade[n_faded : n_faded + len(view)]
            n_faded += len(view)
        return max(first_cut + n_fade, min(self._n_taken, self._n_written))

    def _ring_views(self, first: int, end: int) -> tuple[Samples, Samples]:
        """Return samples `first` to `end` as two views: up to the ring's end, from its start."""
        size = len(self._ring)
        n_here = min(end - first, size - first % size)
        return self._ring[first % size :][:n_here], self._ring[: end - first - n_here]


@dataclass(frozen=True, slots=True)
class PositionReport:
    """A device's report on a block: its first sample is heard at `leaves_s`, its last at `ends_s`.

    Both on the monotonic clock. position_s, end_position_s: the timeline's seconds at these times.
    """

    leaves_s: float
    position_s: float
    ends_s: float
    end_position_s: float

    def at(self, now_s: float) -> tuple[float, float]:
        """Return (monotonic seconds, timeline seconds heard then), as far as known at `now_s`.

        Until `ends_s` it is `leaves_s` with the block's first sample, even in the future; later it
        is `now_s` with the block's end, because the device has no more sound.
        """
        if now_s > self.ends_s:
            return now_s, self.end_position_s
        return self.leaves_s, self.position_s


#: Rates that are tried, best first.
RATES_HZ: Final = (48_000, 44_100, 16_000)
#: How far ahead the device is asked to take sound. Its callback shares Python with a tick of up to
#: some milliseconds; the declared delay (0.2 s and more) leaves room for it.
_BUFFERED_S: Final = 0.05
_BLOCK_S: Final = 0.01
#: A device that says that sound leaves it later than this does not know.
_FARTHEST_S: Final = 2.0


class LoudspeakerOutput:
    """A `lipsync.audio.source.Loudspeaker`; it plays from `__enter__` to `__exit__`.

    The timeline is what was written, sample by sample. Where nothing is ready zeros are played and
    the timeline does not advance, so that the mouth, which follows `position`, waits for the sound.

    `device`: a number, (part of) a name, or None for the system's default. `offsets_ms`: by device
    name or part of it, how much later than the device reports sound is heard (Bluetooth: 250).
    Raises SoundError without PortAudio, for no or an unknown device, and for one that cannot be
    opened. A device that is lost later is searched for once a second, by name, in a thread of its
    own; then the timeline continues where it stopped.
    """

    def __init__(
        self,
        device: str | int | None = None,
        offsets_ms: Mapping[str, float] | None = None,
        *,
        volume: float = 1.0,
        clock: Callable[[], float] = time.monotonic,
        is_watched: bool = True,
    ) -> None:
        """Find the device, without opening it. `device` and `offsets_ms` are as in the class.

        volume: factor on samples, 0 to 1. clock: returns monotonic seconds. is_watched: False where
        no thread watches for the loss of the device, and the caller calls `watch.check` now and
        then.
        """
        self._sounddevice = import_sounddevice()
        with portaudio_lock():
            self._device = find_device(device, "output")
            rate_hz, _ = self._rate_and_channels(RATES_HZ)
        # By name: a number may mean another device after one is plugged in.
        self._wanted_device = self._device.lasting_name if is_number(device) else device
        self._offsets_ms = dict(offsets_ms or {})
        self._volume = np.float32(volume)
        self._clock = clock
        self._is_watched = is_watched
        self._ring = SampleRing(rate_hz)
        self._report: PositionReport | None = None
        self._largest_ahead_s = 0.0
        self._last_dac_s = -np.inf
        self._stream: OpenStream
        self._n_late = self._n_device_underruns = 0
        self.watch = DeviceWatch(self._open, clock)

    @property
    def name(self) -> str:
        """The name of the loudspeaker in use."""
        return self._device.name

    @property
    def lasting_name(self) -> str:
        """The device's name without ALSA's card number, which changes; for a robot's YAML."""
        return self._device.lasting_name

    @property
    def rate_hz(self) -> int:
        """Samples a second: 48,000 where the device can, else 44,100 or 16,000."""
        return self._ring.rate_hz

    @property
    def output_offset_ms(self) -> float:
        """The configured ms by which sound is heard later than this device reports."""
        return offset_ms_of(self._device.name, self._offsets_ms)

    @property
    def latency_s(self) -> float:
        """Seconds from the device's request for a sample until the sample is heard.

        Sound must be written at least so long before it is to be heard, else the device finds
        nothing. It is the larger of the latency that the device claims and that seen so far, plus a
        block of 10 ms and the offset.
        """
        stream = self.watch.stream
        claimed_s = 0.0 if stream is None else stream.latency
        return max(claimed_s, self._largest_ahead_s) + _BLOCK_S + self.output_offset_ms / 1e3

    @property
    def claimed_latency_s(self) -> float:
        """The largest latency in s by the device's own time stamps so far, without the offset."""
        return self._largest_ahead_s

    @property
    def is_lost(self) -> bool:
        """Whether the device is gone: nothing is played, and `position` stays."""
        return self.watch.is_lost

    @property
    def n_underruns(self) -> int:
        """The number of times that it had nothing to play in time: the computer was too slow.

        The device itself, or what was written too late; not what nobody wrote any more.
        """
        return self._n_late + self._n_device_underruns

    def write(self, samples: Samples) -> None:
        """Write the next samples (n,) float32 mono of the timeline, scaled by the volume."""
        self._n_late = self._ring.n_underruns
        self._ring.write(samples if self._volume == 1.0 else samples * self._volume)

    def silence_rest(self) -> float:
        """Play silence in place of everything written that is not on its way to the device.

        Return the timeline position, in seconds, from which on it is silent: 15 ms after the last
        sample that the device has taken, a block that it may be taking just now and a fade of 5 ms.
        """
        return self._ring.silence_rest(round(_BLOCK_S * self.rate_hz)) / self.rate_hz

    def position(self) -> tuple[float, float] | None:
        """Return (monotonic seconds, timeline seconds heard then); None before the first report.

        The device's newest report, usually of a time still to come. When a device is lost or late,
        the position goes on to the end of the sound that it has, and then stays.
        """
        report = self._report  # one object, which the callback replaces: never torn
        return None if report is None else report.at(self._clock())

    def __enter__(self) -> "LoudspeakerOutput":
        self.watch.open()
        if self._is_watched:
            self.watch.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self.watch.close()

    def _open(self) -> OpenStream:
        """Find the device, open and start a stream at the timeline's rate, and return the stream.

        Called by `watch`, at first and after each loss; waits for the device. Raises SoundError.
        """
        self._device = find_device(self._wanted_device, "output")
        # The timeline is counted in samples: another rate would tear it.
        rate_hz, n_channels = self._rate_and_channels((self.rate_hz,))
        try:
            self._stream = self._sounddevice.OutputStream(
                device=self._device.index,
                samplerate=rate_hz,
                channels=n_channels,
                blocksize=round(_BLOCK_S * rate_hz),
                dtype="float32",
                latency=_BUFFERED_S,
                callback=self._play,
            )
            start_stream(self._stream)
        except self._sounddevice.PortAudioError as error:
            raise _cannot_open(self._device, error) from error
        return self._stream

    def _rate_and_channels(self, rates_hz: tuple[int, ...]) -> tuple[int, int]:
        """Return the first of `rates_hz` that the device accepts, and the fewest channels there.

        Raises SoundError if it accepts none.
        """
        failure: Exception | None = None
        for rate_hz in rates_hz:
            for n_channels in sorted({1, 2, self._device.n_channels}):
                try:
                    self._sounddevice.check_output_settings(
                        device=self._device.index,
                        channels=n_channels,
                        dtype="float32",
                        samplerate=rate_hz,
                    )
                except self._sounddevice.PortAudioError as error:
                    failure = error
                else:
                    return rate_hz, n_channels
        raise _cannot_open(self._device, failure)

    def _play(self, frames: Samples, _n_frames: int, timing: "_Timing", status: "_Status") -> None:
        """Fill `frames` (n, channels) with the next samples and record when they are heard.

        PortAudio calls it in its own thread. timing: when the frames leave the device; status:
        whether an underrun came before them.
        """
        called_s, stream_s = self._clock(), self._stream.time
        position_s = self._ring.n_taken / self.rate_hz
        taken_s = self._ring.take_into(frames) / self.rate_hz
        if status.output_underflow:
            self._n_device_underruns += 1
        self.watch.note_call(called_s)
        ahead_s = self._seconds_to_dac(stream_s, timing.outputBufferDacTime)
        leaves_s = called_s + ahead_s + self.output_offset_ms / 1e3
        ends_s = leaves_s + len(frames) / self.rate_hz
        self._report = PositionReport(leaves_s, position_s, ends_s, position_s + taken_s)

    def _seconds_to_dac(self, stream_s: float, dac_s: float) -> float:
        """Return the seconds from `stream_s`, now, until the frames leave the device at `dac_s`.

        Both are of the stream's clock, which is not the monotonic one (with ALSA it is the time of
        day, which may be set), so that only their difference is used. Where it makes no sense, the
        stream's claimed latency is returned.
        """
        ahead_s = dac_s - stream_s
        is_usable = dac_s > self._last_dac_s and 0.0 <= ahead_s < _FARTHEST_S
        self._last_dac_s = dac_s
        if not is_usable:
            return self._stream.latency
        self._largest_ahead_s = max(self._largest_ahead_s, ahead_s)
        return ahead_s


class _Timing(Protocol):
    """The part of PaStreamCallbackTimeInfo that is used, in seconds of the stream's clock."""

    outputBufferDacTime: float  # noqa: N815 - PortAudio's name


class _Status(Protocol):
    """The part of `sounddevice.CallbackFlags` that is used."""

    output_underflow: bool


def _cannot_open(device: SoundDevice, error: Exception | None) -> SoundError:
    return SoundError(
        f"loudspeaker {device.name!r} cannot be opened ({error}); close what else uses it"
    )
