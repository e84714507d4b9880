"""A recording session: sentence after sentence, controlled by keys; takes are saved at once.

The person who is recorded sees the sentence, the sound level, and which keys to press.

`SoundClock`: when the microphone's sound was captured, on the monotonic clock of the pictures.
"""

import enum
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Protocol

import numpy as np

from lipservo.calibrating.camera import Frame
from lipservo.terminal.output import MESSAGES
from lipservo_lab.recording.sentence_list import Sentence
from lipservo_lab.recording.take import (
    KEY_S,
    Take,
    TakeDiscarded,
    brightness,
    sound_level_db,
    take_files,
)
from lipsync.audio.source import SoundError
from lipsync.audio_block import AudioBlock

_BAR = 30
#: The bar is empty at this level, dB below full scale.
_EMPTY_DB = -60.0


class Screen:
    """Lines on stderr; under them a level meter, where stderr is a terminal."""

    def __init__(self, *, quiet: bool = False) -> None:
        self._is_quiet = quiet
        self._has_meter = MESSAGES.is_terminal and not quiet

    def show(self, sentence: Sentence, number: int, total: int) -> None:
        """Show the sentence to be read, even in quiet mode."""
        self._line(f"\n{number} of {total}  {sentence.name}\n", "dim")
        self._line(f"    {sentence.text}\n", "bold")

    def say(self, line: str) -> None:
        """Show what is going on, and which keys can be pressed."""
        if not self._is_quiet:
            self._line(line, "")

    def warn(self, line: str) -> None:
        """Show what is wrong with a take."""
        self._line(f"! {line}", "yellow")

    def meter(self, level_db: float, brightness: float) -> None:
        """Draw a bar of the sound's level, dB, and the picture's brightness, 0 to 255."""
        if not self._has_meter:
            return
        full = min(_BAR, max(0, round((1.0 - level_db / _EMPTY_DB) * _BAR)))
        bar = "#" * full + "." * (_BAR - full)
        MESSAGES.file.write(f"\r[{bar}] {level_db:4.0f} dB  brightness {brightness:3.0f} ")
        MESSAGES.file.flush()

    def end(self) -> None:
        """Leave the meter's line."""
        if self._has_meter:
            MESSAGES.file.write("\n")

    def _line(self, text: str, style: str) -> None:
        if self._has_meter:
            MESSAGES.file.write("\r\x1b[2K")  # over the meter
        MESSAGES.print(text, style=style, soft_wrap=True)


#: Number of blocks, two seconds, whose time stamps count: a sound card's clock drifts by less than
#: 0.1 ms in that time.
_REMEMBERED = 200


class SoundClock:
    """The monotonic time of a sample: by the median of the device's latest reports.

    A single report is off by some milliseconds when the computer is busy.
    """

    def __init__(self) -> None:
        self._zeros_s: deque[float] = deque(maxlen=_REMEMBERED)
        self._last: tuple[float, float] | None = None

    def observe(self, captured: tuple[float, float] | None) -> None:
        """Note a report (monotonic seconds, sound time captured then), or None."""
        if captured is not None and captured != self._last:
            self._last = captured
            self._zeros_s.append(captured[0] - captured[1])

    @property
    def is_ready(self) -> bool:
        """Whether any sound has come."""
        return bool(self._zeros_s)

    @property
    def zero_s(self) -> float:
        """The monotonic time at which sound time 0 was captured."""
        return median(self._zeros_s)


#: Pictures arrive later than sound: time to wait for the last ones of a take.
_PICTURES_S = 0.3
#: How long a microphone may take to give its first sound.
_PATIENCE_S = 5.0
_TICK_S = 0.02
_METER_S = 0.1
#: A take this long was forgotten, and is ended.
_LONGEST_S = 60.0


class Microphone(Protocol):
    """The part of `MicrophoneSource` that is used."""

    @property
    def captured(self) -> tuple[float, float] | None:
        """Monotonic seconds, and the sound time captured then."""

    @property
    def lost_blocks(self) -> int:
        """Blocks of sound that were lost so far."""

    @property
    def is_lost(self) -> bool:
        """Whether the device is gone."""

    def blocks(self, until_s: float) -> list[AudioBlock]:
        """Return new blocks that end at or before sound time `until_s`."""


class Pictures(Protocol):
    """The part of `CameraFeed` that is used."""

    def take_frames(self) -> list[Frame]:
        """Return the pictures since the last call."""


@dataclass(frozen=True, slots=True)
class Devices:
    """Camera, microphone and keys of a session.

    rate_hz: pictures a second of the camera. next_key: waits up to some seconds for a key; returns
    it, or None. is_stopped: returns whether a signal came. clock: returns monotonic seconds.
    """

    microphone: Microphone
    pictures: Pictures
    rate_hz: float
    next_key: Callable[[float], str | None]
    is_stopped: Callable[[], bool]
    clock: Callable[[], float]
    sleep: Callable[[float], None]


@dataclass(slots=True)
class Outcome:
    """Names of recorded and skipped sentences, and warnings about recorded ones."""

    recorded: list[str] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)
    warnings: dict[str, tuple[str, ...]] = field(default_factory=dict)


class _NextStep(enum.Enum):
    NEXT = enum.auto()
    AGAIN = enum.auto()
    BACK = enum.auto()
    STOP = enum.auto()


class Session:
    """Records the sentences that the folder lacks; recorded ones can be repeated."""

    def __init__(self, devices: Devices, screen: Screen, folder: Path) -> None:
        self._devices, self._screen, self._folder = devices, screen, folder
        self._clock = SoundClock()
        self._heard_s = self._metered_s = 0.0
        self._level_db = -90.0
        self._brightness = 0.0
        self._outcome = Outcome()

    def run(self, sentences: Sequence[Sentence], recorded: set[str]) -> Outcome:
        """Record until all sentences are read, or the person stops; the devices are open.

        recorded: names of sentences that the folder has. Raises SoundError, CameraError or
        OutputError if a device or the disk fails; recordings so far are kept.
        """
        self._wait_for_sound()
        number = 0
        while 0 <= number < len(sentences):
            sentence = sentences[number]
            if sentence.name in recorded:
                number += 1
                continue
            self._screen.show(sentence, number + 1, len(sentences))
            step = self._wait_for_choice(sentence)
            if step is _NextStep.STOP:
                break
            if step is _NextStep.BACK:
                number = max(0, number - 1)
                recorded.discard(sentences[number].name)
            elif step is _NextStep.NEXT:
                number += 1
        return self._outcome

    def _wait_for_choice(self, sentence: Sentence) -> _NextStep:
        """Wait for a key; record the sentence, or return another step, as the key says."""
        self._screen.say("space: record · s: skip · b: back · q: stop")
        while True:
            key, _, _ = self._tick()
            if self._devices.is_stopped() or key == "q":
                return _NextStep.STOP
            if key == "b":
                return _NextStep.BACK
            if key == "s":
                self._outcome.skipped.append(sentence.name)
                return _NextStep.NEXT
            if key in (" ", "\n", "\r"):
                return self._record(sentence)

    def _record(self, sentence: Sentence) -> _NextStep:
        """Record one take of a sentence; return whether to go on, repeat it or stop."""
        step = _NextStep.AGAIN
        warnings: tuple[str, ...] = ()
        with take_files(self._folder, sentence) as (clip, sound):
            take = Take(clip, self._heard_s + KEY_S, self._clock.zero_s, self._devices.rate_hz)
            try:
                lost_before = self._devices.microphone.lost_blocks
                self._screen.say("RECORDING · space: done · r: again · q: stop without it")
                step = self._record_until_key(take)
                if step is not _NextStep.NEXT:
                    raise TakeDiscarded
                lost = self._devices.microphone.lost_blocks - lost_before
                if take.is_empty:
                    self._screen.warn("no picture or no sound came: once again")
                    step = _NextStep.AGAIN
                    raise TakeDiscarded
                warnings = take.finish(sound, lost)
                step = self._step_after(warnings)
                if step is not _NextStep.NEXT:
                    raise TakeDiscarded
            finally:
                take.close()
        if step is _NextStep.NEXT:
            self._outcome.recorded.append(sentence.name)
            if warnings:
                self._outcome.warnings[sentence.name] = warnings
            self._screen.say(f"kept: {sentence.name}")
        return step

    def _record_until_key(self, take: Take) -> _NextStep:
        """Record until a key ends the sentence or `_LONGEST_S` are over; return what to do next."""
        begun_s = self._heard_s
        while True:
            key, blocks, frames = self._tick()
            take.add_blocks(blocks)
            take.add_frames(frames)
            if self._devices.is_stopped() or key == "q":
                return _NextStep.STOP
            if key == "r":
                return _NextStep.AGAIN
            is_forgotten = self._heard_s - begun_s > _LONGEST_S
            if key in (" ", "\n", "\r") or is_forgotten:
                take.end(self._heard_s - KEY_S)
                until_s = self._devices.clock() + _PICTURES_S
                while self._devices.clock() < until_s:
                    _, blocks, frames = self._tick(reads_keys=False)
                    take.add_blocks(blocks)
                    take.add_frames(frames)
                return _NextStep.NEXT

    def _step_after(self, warnings: tuple[str, ...]) -> _NextStep:
        """Return what to do with a take: keep it without warnings, else let the person decide."""
        if not warnings:
            return _NextStep.NEXT
        for line in warnings:
            self._screen.warn(line)
        self._screen.say("space: again · k: keep it all the same · q: stop without it")
        while True:
            key, _, _ = self._tick()
            if self._devices.is_stopped() or key == "q":
                return _NextStep.STOP
            if key == "k":
                return _NextStep.NEXT
            if key in (" ", "\n", "\r", "r"):
                return _NextStep.AGAIN

    def _tick(self, *, reads_keys: bool = True) -> tuple[str | None, list[AudioBlock], list[Frame]]:
        """Wait 20 ms; return the key pressed, and the sound and pictures that came.

        Raises SoundError when the microphone is gone.
        """
        key = None
        if reads_keys:
            key = self._devices.next_key(_TICK_S)
        else:
            self._devices.sleep(_TICK_S)
        blocks = self._devices.microphone.blocks(np.inf)
        self._clock.observe(self._devices.microphone.captured)
        if self._devices.microphone.is_lost:
            raise SoundError("the microphone is gone; plug it in and start again")
        frames = self._devices.pictures.take_frames()
        if blocks:
            self._heard_s = blocks[-1].end_s
            level_db = sound_level_db(np.concatenate([block.samples for block in blocks]))
            self._level_db = max(level_db, self._level_db - 1.0)
        now_s = self._devices.clock()
        if now_s - self._metered_s >= _METER_S:
            self._metered_s = now_s
            if frames:
                self._brightness = brightness(frames[-1][1])
            self._screen.meter(self._level_db, self._brightness)
        return key, blocks, frames

    def _wait_for_sound(self) -> None:
        """Wait until the time of the sound is known, or for a stop.

        Raises SoundError after `_PATIENCE_S` without sound.
        """
        until_s = self._devices.clock() + _PATIENCE_S
        while not self._clock.is_ready:
            self._tick(reads_keys=False)
            if self._devices.is_stopped():
                return
            if self._devices.clock() > until_s:
                raise SoundError(
                    f"the microphone has given no sound in {_PATIENCE_S:.0f} s; is it muted, or "
                    "another one meant (--mic)?"
                )
