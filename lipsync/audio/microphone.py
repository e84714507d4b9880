"""A microphone through PortAudio, as a live source of sound."""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final, Protocol

import numpy as np
import soxr
from numpy.typing import NDArray

from lipsync.audio.channels import MIX, channel_index
from lipsync.audio.devices import (
    DeviceWatch,
    OpenStream,
    find_device,
    import_sounddevice,
    is_number,
    portaudio_lock,
    start_stream,
)
from lipsync.audio.source import BLOCK_SAMPLES, BlockCutter, SoundError
from lipsync.audio_block import BLOCK_S, SAMPLE_RATE_HZ, AudioBlock

Samples = NDArray[np.float32]

#: Sound that waited longer than this is dropped, the oldest first: too late to be shown.
QUEUE_S: Final = 2.0
#: A clock of the sound card that reports a longer gap than this is ignored.
LONGEST_GAP_S: Final = 10.0
#: A device that says that it captured sound longer ago than this does not know.
_OLDEST_S: Final = 2.0
#: soxr's "LQ" is flat to 6 kHz and holds back at most 20 ms; "HQ" gains 1.5 kHz for 37 ms (48 kHz).
RESAMPLING: Final = "LQ"


class MicrophoneSource:
    """A live `AudioSource`; it listens from `__enter__` to `__exit__`.

    `device`: an index, (part of) a name, or None for the system's default. Sound that is lost,
    because the computer read too late or the device overran, becomes silence of equal length, so
    that sound time stays right. The sound that has arrived counts, not the clock: pass
    `until_s=inf` to `blocks` for all of it. Raises SoundError without PortAudio, for no or an
    unknown device, and for one that refuses to open. A device that is lost later is silent as long
    as it is away; it is searched for once a second, by name, in a thread of its own.
    """

    duration_s: float | None = None
    is_live = True

    def __init__(
        self,
        device: str | int | None = None,
        *,
        clock: Callable[[], float] = time.monotonic,
        is_watched: bool = True,
        channel: str = MIX,
    ) -> None:
        """Find the device, without opening it. `device`: see the class; `clock`: monotonic seconds.

        channel: the one that is heard, `left`, `right`, `mix` or a number from 1; SoundError where
        the device has fewer. is_watched: False where no thread watches for the loss of the device,
        and the caller calls `watch.check` from time to time.
        """
        self._sounddevice = import_sounddevice()
        with portaudio_lock():
            self._device = find_device(device, "input")
        # By name: a number may mean another device after one is plugged in.
        self._wanted_device = self._device.lasting_name if is_number(device) else device
        channel_index(channel, self._device.n_channels, self.name)
        self._channel = channel
        self._clock = clock
        self._is_watched = is_watched
        self.watch = DeviceWatch(self._open, clock)
        self._reset()

    @property
    def name(self) -> str:
        """The name of the microphone in use."""
        return self._device.name

    @property
    def lost_blocks(self) -> int:
        """The number of blocks of 10 ms replaced by silence so far, rounded up at each loss."""
        return self._lost_blocks + -(-self._n_away // BLOCK_SAMPLES)

    @property
    def n_losses(self) -> int:
        """The number of times that the device was unplugged or stopped so far."""
        return self.watch.n_losses

    @property
    def is_lost(self) -> bool:
        """Whether the device was lost and is being searched for, or was never opened."""
        return self.watch.is_lost

    @property
    def captured(self) -> tuple[float, float] | None:
        """The device's newest time stamp: (monotonic seconds, sound time captured then).

        Of the sound that `blocks` has processed so far; None before the first.
        """
        return self._captured

    def blocks(self, until_s: float) -> list[AudioBlock]:
        """Return the blocks, not returned before, that end at or before sound time `until_s`.

        Adds the samples that arrived, of each opening of the device (capture) in turn; an older
        capture ends when a newer one follows. While the microphone is lost, silence is added.
        """
        now_s, n_losses = self._clock(), self.n_losses
        while len(self._captures) > 1:
            self._add_arrivals(self._captures.popleft(), has_ended=True)
        capture = self._captures[0]
        # Not `is_lost`: while the device is reopened, its new capture may have begun.
        has_ended = capture.n_losses < n_losses
        self._add_arrivals(capture, has_ended=has_ended)
        if has_ended or (n_losses and capture.begins_s is None):
            self._fill_silence(now_s)
        return self._cutter.take(until_s)

    def __enter__(self) -> "MicrophoneSource":
        self._reset()
        self.watch.open()
        if self._is_watched:
            self.watch.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self.watch.close()

    def _reset(self) -> None:
        """Reset the source to sound time 0, with no capture, no samples and no lost blocks."""
        # One for each time that the device was opened; all but the newest have ended.
        self._captures: deque[_Capture] = deque()
        self._n_pushed = 0  # samples at 16 kHz that went on to the cutter
        self._lost_blocks = 0
        self._n_away = 0  # samples of silence at 16 kHz, given while the device was away
        # Clock time of the last sound that arrived, or the end of the silence put in its place.
        self._until_s = self._clock()
        self._captured: tuple[float, float] | None = None
        self._cutter = BlockCutter()

    def _open(self) -> OpenStream:
        """Find the device, open and start a stream that queues its sound, and return the stream.

        Called by `watch`, at first and after each loss; waits for the device. Raises SoundError.
        """
        device = find_device(self._wanted_device, "input")
        channel = channel_index(self._channel, device.n_channels, device.name)
        self._device = device
        rate_hz, n_channels = self._rate_and_channels(1 if channel is None else device.n_channels)
        make_stream = partial(
            self._sounddevice.InputStream,
            device=self._device.index,
            samplerate=rate_hz,
            channels=n_channels,
            blocksize=round(BLOCK_S * rate_hz),
            dtype="float32",
            latency="low",
        )
        try:
            capture = _Capture(make_stream, rate_hz, self._clock, self.watch, channel)
            self._captures.append(capture)
            start_stream(capture.stream)
        except self._sounddevice.PortAudioError as error:
            raise SoundError(
                f"microphone {self.name!r} cannot be opened ({error}); close what else uses it"
            ) from error
        return capture.stream

    def _rate_and_channels(self, n_wanted: int) -> tuple[int, int]:
        """Return rate in Hz and number of channels to open the device with.

        The first that the device accepts: 16 kHz, or its own rate, with `n_wanted` channels, else
        its own rate with all channels.
        """
        own_rate_hz = self._device.sample_rate_hz
        for rate_hz, n_channels in ((SAMPLE_RATE_HZ, n_wanted), (own_rate_hz, n_wanted)):
            try:
                self._sounddevice.check_input_settings(
                    device=self._device.index,
                    channels=n_channels,
                    dtype="float32",
                    samplerate=rate_hz,
                )
            except self._sounddevice.PortAudioError:
                continue
            return rate_hz, n_channels
        return own_rate_hz, self._device.n_channels

    def _add_arrivals(self, capture: "_Capture", *, has_ended: bool) -> None:
        """Add all that `capture` has queued; if it has ended, also what its resampler held."""
        while capture.arrived:
            self._add_arrival(capture, capture.arrived.popleft())
        if has_ended:
            self._push_samples(capture.rest())

    def _add_arrival(self, capture: "_Capture", arrival: "_Arrival") -> None:
        """Add the samples of one callback, after silence for those lost before them, to the blocks.

        capture: the opening of the device that delivered `arrival`.
        """
        if capture.begins_s is None:
            if self.n_losses:  # the device was away
                self._fill_silence(arrival.called_s - len(arrival.samples) / capture.rate_hz)
            capture.begin(self._n_pushed / SAMPLE_RATE_HZ)
        n_missing = arrival.first_sample - capture.n_taken
        if n_missing:
            lost = capture.convert(np.zeros(n_missing, dtype=np.float32))
            self._lost_blocks += -(-len(lost) // BLOCK_SAMPLES)
            self._push_samples(lost)
        self._push_samples(capture.convert(arrival.samples))
        self._until_s = arrival.called_s
        sound_s = (capture.begins_s or 0.0) + arrival.first_sample / capture.rate_hz
        self._captured = (arrival.captured_s, sound_s)

    def _fill_silence(self, until_s: float) -> None:
        """Add silence to the blocks for a device that is away, up to the clock time `until_s`."""
        n = max(0, round((until_s - self._until_s) * SAMPLE_RATE_HZ))
        self._until_s += n / SAMPLE_RATE_HZ
        self._n_away += n
        self._push_samples(np.zeros(n, dtype=np.float32))

    def _push_samples(self, samples: Samples) -> None:
        """Add samples (n,) at 16 kHz to the blocks, NaN as 0, clipped to [-1, 1]."""
        self._n_pushed += len(samples)
        self._cutter.push(np.clip(np.nan_to_num(samples), -1.0, 1.0))


@dataclass(frozen=True, slots=True)
class _Arrival:
    """The samples that one callback of the device delivered.

    first_sample: number of the first one since this opening of the device, at the device's rate.
    captured_s, called_s: when the first sample was captured, and when the callback came, on the
    monotonic clock.
    """

    first_sample: int
    samples: Samples
    captured_s: float
    called_s: float


class _Capture:
    """One opening of the device: its callback queues sound that `MicrophoneSource.blocks` takes."""

    def __init__(
        self,
        make_stream: Callable[..., OpenStream],
        rate_hz: int,
        clock: Callable[[], float],
        watch: DeviceWatch,
        channel: int | None,
    ) -> None:
        """Make the stream by `make_stream(callback=...)`, without starting it.

        rate_hz: the device's; clock: returns monotonic seconds; watch: is notified of each
        callback; channel: the one that is heard, from 0, None: all are mixed.
        """
        self._channel = channel
        #: Times that the device had been lost before; more: this capture has ended.
        self.n_losses = watch.n_losses
        self.rate_hz = rate_hz
        self.arrived: deque[_Arrival] = deque(maxlen=round(QUEUE_S / BLOCK_S))
        #: Changed by the reading thread alone: first sample's sound time, samples taken so far.
        self.begins_s: float | None = None
        self.n_taken = 0
        self._clock = clock
        self._watch = watch
        # Changed by the callback alone.
        self._n_heard = 0  # samples at the device's rate, lost ones among them
        self._next_adc_s: float | None = None  # when the device takes the next sample
        is_same = rate_hz == SAMPLE_RATE_HZ
        self._resampler = (
            None
            if is_same
            else soxr.ResampleStream(
                rate_hz, SAMPLE_RATE_HZ, 1, dtype="float32", quality=RESAMPLING
            )
        )
        self.stream = make_stream(callback=self.enqueue)

    def enqueue(self, frames: Samples, n_frames: int, timing: "_Timing", status: "_Status") -> None:
        """Queue the frames (n, channels), mixed to mono; PortAudio calls it in its own thread.

        timing: when the frames were captured; status: whether samples were lost before them, which
        are then counted. A full queue drops its oldest entry; the reader sees the gap in the sample
        count.
        """
        called_s, adc_s = self._clock(), timing.inputBufferAdcTime
        # The stream's clock is not the monotonic one: only a difference is used.
        age_s = self.stream.time - adc_s
        length_s = n_frames / self.rate_hz
        if not (adc_s > 0.0 and 0.0 <= age_s < _OLDEST_S):
            age_s = max(length_s, self.stream.latency)
        if status.input_overflow:
            self._n_heard += self._count_lost(adc_s, n_frames)
        channel = self._channel
        samples: Samples = frames.mean(axis=1) if channel is None else frames[:, channel].copy()
        self.arrived.append(_Arrival(self._n_heard, samples, called_s - age_s, called_s))
        self._n_heard += n_frames
        self._next_adc_s = adc_s + length_s
        self._watch.note_call(called_s)

    def convert(self, samples: Samples) -> Samples:
        """Return the next samples resampled to 16 kHz, except some held back until more come."""
        self.n_taken += len(samples)
        if self._resampler is None:
            return samples
        converted: Samples = self._resampler.resample_chunk(samples)
        return converted

    def begin(self, sound_s: float) -> None:
        """Store the sound time of the first sample."""
        self.begins_s = sound_s

    def rest(self) -> Samples:
        """Return, once, the samples at 16 kHz that the resampler has held back; then empty.

        What a device that wakes late delivers after that is dropped.
        """
        self.arrived = deque(maxlen=0)
        resampler, self._resampler = self._resampler, None
        nothing = np.zeros(0, np.float32)
        return nothing if resampler is None else resampler.resample_chunk(nothing, last=True)

    def _count_lost(self, adc_s: float, n_frames: int) -> int:
        """Return how many samples were lost before a buffer of `n_frames` captured at `adc_s`.

        Counted from the gap in the device's clock; `n_frames` where it shows no gap or one above 10
        s.
        """
        gap_s = 0.0 if self._next_adc_s is None else adc_s - self._next_adc_s
        return round(gap_s * self.rate_hz) if 0.0 < gap_s <= LONGEST_GAP_S else n_frames


class _Timing(Protocol):
    """The part of PaStreamCallbackTimeInfo that is used, in seconds of the stream's clock."""

    inputBufferAdcTime: float  # noqa: N815 - PortAudio's name


class _Status(Protocol):
    """The part of `sounddevice.CallbackFlags` that is used."""

    input_overflow: bool
