"""A microphone, through PortAudio.

sounddevice is imported only when a microphone is asked for: a robot that plays files needs no
PortAudio.
"""

from collections import deque
from dataclasses import dataclass
from types import ModuleType
from typing import Protocol

import numpy as np
import soxr
from numpy.typing import NDArray

from lipsync.audio.cutter import BLOCK_SAMPLES, BlockCutter
from lipsync.audio.source import SoundError
from lipsync.audio_block import BLOCK_S, SAMPLE_RATE_HZ, AudioBlock

#: Sound that waited longer than this is not worth showing any more; the oldest is dropped.
QUEUE_S = 2.0
#: A clock of the sound card that reports a longer gap than this is ignored.
LONGEST_GAP_S = 10.0
#: soxr's "LQ" is flat to 6 kHz and holds back at most 20 ms; "HQ" gains 1.5 kHz for 37 ms (48 kHz).
RESAMPLING = "LQ"


@dataclass(frozen=True, slots=True)
class InputDevice:
    """A device that can be listened to; `sample_rate_hz` is the rate it likes best."""

    index: int
    name: str
    n_channels: int
    sample_rate_hz: int
    is_default: bool


def input_devices() -> tuple[InputDevice, ...]:
    """All devices with at least one input channel; SoundError when there is no PortAudio."""
    sounddevice = _sounddevice()
    default_index = sounddevice.default.device[0]
    return tuple(
        InputDevice(
            index=index,
            name=str(device["name"]),
            n_channels=int(device["max_input_channels"]),
            sample_rate_hz=round(device["default_samplerate"]),
            is_default=index == default_index,
        )
        for index, device in enumerate(sounddevice.query_devices())
        if device["max_input_channels"] > 0
    )


class MicrophoneSource:
    """A live `AudioSource`; it listens from `__enter__` to `__exit__`.

    `device`: an index, (part of) a name, or None for the system's default. What is lost, because
    the computer read too late or the device overran, becomes silence of the same length, so
    that sound time goes on being right. Sound that has arrived counts, not the clock: pass
    `until_s=inf` to `blocks` for all of it. Raises SoundError for no PortAudio, no or unknown
    device, a device that refuses to open, and one that is unplugged.
    """

    duration_s: float | None = None
    is_live = True

    def __init__(self, device: str | int | None = None) -> None:
        self._sounddevice = _sounddevice()
        self._device = _find(self._sounddevice, device)
        self._stream: _Stream | None = None
        self._start_afresh(SAMPLE_RATE_HZ)

    @property
    def name(self) -> str:
        """The device's own name."""
        return self._device.name

    @property
    def lost_blocks(self) -> int:
        """Blocks' worth of sound replaced by silence so far, rounded up at each loss."""
        return self._lost_blocks

    def blocks(self, until_s: float) -> list[AudioBlock]:
        """The blocks not handed out before that end at or before sound time `until_s`."""
        if self._stream is not None and not self._stream.active:
            raise SoundError(f"microphone {self.name!r} stopped; check its plug and start again")
        while self._arrived:
            first_sample, samples = self._arrived.popleft()
            self._push(np.zeros(first_sample - self._n_taken, dtype=np.float32), is_lost=True)
            self._push(samples, is_lost=False)
        return self._cutter.take(until_s)

    def __enter__(self) -> "MicrophoneSource":
        rate_hz, n_channels = self._rate_and_channels()
        self._start_afresh(rate_hz)
        try:
            self._stream = self._sounddevice.InputStream(
                device=self._device.index,
                samplerate=rate_hz,
                channels=n_channels,
                blocksize=round(BLOCK_S * rate_hz),
                dtype="float32",
                latency="low",
                callback=self._hear,
            )
            self._stream.start()
        except self._sounddevice.PortAudioError as error:
            self.__exit__()
            raise SoundError(
                f"microphone {self.name!r} cannot be opened ({error}); close what else uses it"
            ) from error
        return self

    def __exit__(self, *exc: object) -> None:
        if self._stream is not None:
            self._stream.close()
            self._stream = None

    def _start_afresh(self, rate_hz: int) -> None:
        n_queued = round(QUEUE_S / BLOCK_S)
        self._arrived: deque[tuple[int, NDArray[np.float32]]] = deque(maxlen=n_queued)
        self._rate_hz = rate_hz
        self._n_heard = 0  # samples at the device's rate, lost ones among them: the callback's
        self._next_adc_s: float | None = None  # when the device takes the next sample: likewise
        self._n_taken = 0  # samples at the device's rate that went on to the cutter
        self._lost_blocks = 0
        self._cutter = BlockCutter()
        self._resampler = (
            None
            if rate_hz == SAMPLE_RATE_HZ
            else soxr.ResampleStream(
                rate_hz, SAMPLE_RATE_HZ, 1, dtype="float32", quality=RESAMPLING
            )
        )

    def _rate_and_channels(self) -> tuple[int, int]:
        """16 kHz mono if the device can, else its own rate and as few channels as it allows."""
        own_rate_hz, all_channels = self._device.sample_rate_hz, self._device.n_channels
        for rate_hz, n_channels in ((SAMPLE_RATE_HZ, 1), (own_rate_hz, 1)):
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
        return own_rate_hz, all_channels

    def _hear(
        self,
        frames: NDArray[np.float32],
        n_frames: int,
        timing: "_Timing",
        status: "_Status",
    ) -> None:
        """PortAudio's thread: note what was lost before these frames (n, channels), queue a copy.

        A full queue drops its oldest entry; the reader sees the hole in the sample count.
        """
        if status.input_overflow:
            self._n_heard += self._n_lost(timing.inputBufferAdcTime, n_frames)
        self._arrived.append((self._n_heard, frames.mean(axis=1)))
        self._n_heard += n_frames
        self._next_adc_s = timing.inputBufferAdcTime + n_frames / self._rate_hz

    def _n_lost(self, adc_s: float, n_frames: int) -> int:
        """Samples lost before a buffer taken at `adc_s`; one buffer when the clock does not say."""
        gap_s = 0.0 if self._next_adc_s is None else adc_s - self._next_adc_s
        return round(gap_s * self._rate_hz) if 0.0 < gap_s <= LONGEST_GAP_S else n_frames

    def _push(self, samples: NDArray[np.float32], *, is_lost: bool) -> None:
        if len(samples) == 0:
            return
        self._n_taken += len(samples)
        if self._resampler is not None:
            samples = self._resampler.resample_chunk(samples)
        if is_lost:
            self._lost_blocks += -(-len(samples) // BLOCK_SAMPLES)
        self._cutter.push(np.clip(np.nan_to_num(samples), -1.0, 1.0))


class _Stream(Protocol):
    """What is used of `sounddevice.InputStream`."""

    @property
    def active(self) -> bool: ...
    def start(self) -> None: ...
    def close(self) -> None: ...


class _Timing(Protocol):
    """What is used of PaStreamCallbackTimeInfo, in seconds of the stream's clock."""

    inputBufferAdcTime: float  # noqa: N815 - PortAudio's name


class _Status(Protocol):
    """What is used of `sounddevice.CallbackFlags`."""

    input_overflow: bool


def _sounddevice() -> ModuleType:
    """The sounddevice module, or SoundError when it or its PortAudio library is missing."""
    try:
        import sounddevice
    except ImportError as error:
        raise SoundError(
            "no sounddevice package: install it with `pip install sounddevice`"
        ) from error
    except OSError as error:  # what it raises when the library is not found
        raise SoundError(
            "no PortAudio library: install it with `apt install libportaudio2`"
        ) from error
    module: ModuleType = sounddevice
    return module


def _find(sounddevice: ModuleType, wanted: str | int | None) -> InputDevice:
    devices = input_devices()
    if not devices:
        raise SoundError("no microphone: plug one in, or play a file instead")
    # A shell hands an index over as text.
    key = int(wanted) if isinstance(wanted, str) and wanted.isdecimal() else wanted
    try:
        index = sounddevice.query_devices(key, "input")["index"]
        return next(device for device in devices if device.index == index)
    except (ValueError, StopIteration, sounddevice.PortAudioError) as error:
        known = "; ".join(f"{device.index} {device.name}" for device in devices)
        what = "no default microphone" if wanted is None else f"no single microphone {wanted!r}"
        raise SoundError(f"{what}; name one of: {known}") from error
