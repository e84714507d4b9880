"""Simulated servos of any bus that keep an exact log of their own torque, pulses and shafts.

The log is written where bytes arrive, by the simulator alone: nothing that a program says of the
servos reaches it. What the campaigns hold statements against.
"""

import threading
import time
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.pca9685.registers import Mode1, Register, counts_of
from firmware_bridge.pulse_servos import PulseScale
from firmware_bridge.simulator.motors import PULSES_PER_DEG
from firmware_bridge.simulator.ports import SimulatedDevice

#: Shafts are logged this often.
_SHAFTS_EVERY_S: Final = 0.02
_FOREVER: Final = float("inf")
#: Transfers that a chip whose wire is broken does not acknowledge.
_EVERY_TRANSFER: Final = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Moment:
    """A record of the log: which servos have torque from `time_s` (monotonic) on.

    on: of each servo; of hobby servos: it gets pulses. pulses_us: the pulse of each, 0: none is
    sent; empty unless they are hobby servos.
    """

    time_s: float
    on: tuple[bool, ...]
    pulses_us: tuple[float, ...] = ()


class ServoTruth(Protocol):
    """What a simulator itself knows of its servos, and how to make them deaf."""

    @property
    def on(self) -> tuple[bool, ...]:
        """Which servos have torque now: of hobby servos, which get pulses."""

    @property
    def pulses_us(self) -> tuple[float, ...]:
        """The pulses that hobby servos get now, us; empty for other servos."""

    def shafts_deg(self) -> NDArray[np.float64]:
        """Where the shafts are, (n_servos,) degrees."""

    def mute(self, index: int | None, *, muted: bool) -> None:
        """Let a servo receive nothing any more, or again. index: None: all of the device."""


class SerialTruth:
    """`ServoTruth` of a simulated chain of Dynamixel or Feetech servos."""

    pulses_us: tuple[float, ...] = ()

    def __init__(self, chain: Any, silence: str) -> None:
        """Look at `chain`. silence: the attribute that has the end of a servo's silence."""
        self._chain, self._motors, self._silence = chain, chain.motors, silence

    @property
    def on(self) -> tuple[bool, ...]:
        """Which torque registers are set."""
        return tuple(self._motors.torque_on.tolist())

    def shafts_deg(self) -> NDArray[np.float64]:
        """Where the shafts are, (n_servos,) degrees."""
        return np.asarray(self._motors.position / PULSES_PER_DEG)

    def mute(self, index: int | None, *, muted: bool) -> None:
        """Cut the wire to a servo, or to all."""
        chosen = self._chain.servos if index is None else [self._chain.servos[index]]
        for servo in chosen:
            setattr(servo, self._silence, _FOREVER if muted else 0.0)


class MaestroTruth:
    """`ServoTruth` of a simulated Maestro. numbers: its channels in the order of the joints."""

    def __init__(self, maestro: Any, numbers: Sequence[int], scale: PulseScale) -> None:
        self._maestro, self._scale = maestro, scale
        self._channels = [maestro.channels[each] for each in numbers]

    @property
    def on(self) -> tuple[bool, ...]:
        """Which channels send pulses."""
        return tuple(each.position > 0.0 for each in self._channels)

    @property
    def pulses_us(self) -> tuple[float, ...]:
        """The pulse of each channel; the Maestro counts in quarters of a us."""
        return tuple(each.position / 4.0 for each in self._channels)

    def shafts_deg(self) -> NDArray[np.float64]:
        """Where the shafts are, (n_servos,) degrees."""
        return self._scale.joints_deg(np.array([each.shaft.place_us for each in self._channels]))

    def mute(self, index: int | None, *, muted: bool) -> None:
        """Hang a Maestro: it goes on with its pulses, but reads nothing. index: None only."""
        if index is not None:
            raise ValueError("a Maestro's channels do not answer one by one")
        self._maestro.deaf = muted


class Pca9685Truth:
    """`ServoTruth` of a simulated PCA9685, from its registers. numbers: as of `MaestroTruth`."""

    def __init__(self, chip: Any, numbers: Sequence[int]) -> None:
        self._chip, self._numbers = chip, tuple(numbers)

    @property
    def on(self) -> tuple[bool, ...]:
        """Which outputs send pulses."""
        return tuple(each > 0.0 for each in self.pulses_us)

    @property
    def pulses_us(self) -> tuple[float, ...]:
        """The pulse of each output; none while the chip sleeps or waits for its restart."""
        registers = self._chip.registers
        if registers[Register.MODE1] & (Mode1.SLEEP | Mode1.RESTART):
            return (0.0,) * len(self._numbers)
        first_registers = [Register.LED0_ON_L + 4 * each for each in self._numbers]
        counts = [counts_of(bytes(registers[each : each + 4])) for each in first_registers]
        return tuple(each * self._chip.count_us for each in counts)

    def shafts_deg(self) -> NDArray[np.float64]:
        """Where the shafts are, (n_servos,) degrees."""
        return np.array([self._chip.servos[each].place_deg for each in self._numbers])

    def mute(self, index: int | None, *, muted: bool) -> None:
        """Break the wire: the chip goes on with its pulses, and acknowledges nothing."""
        if index is not None:
            raise ValueError("a PCA9685's outputs do not answer one by one")
        self._chip.nacks = _EVERY_TRANSFER if muted else 0


class LoggedDevice:
    """A simulated device that a `PtyHost` serves, which logs each change of torque and pulses.

    device: the simulator. records: the log, oldest first; shafts: (time, degrees of each), some
    fifty a second. The host's thread writes both, and any thread may read them.
    """

    def __init__(self, device: SimulatedDevice, truth: ServoTruth) -> None:
        """Log what `truth` tells of `device`, from now on."""
        self.truth = truth
        self.device = device
        self._is_out = threading.Event()
        self._shafts_s = 0.0
        self.shafts: list[tuple[float, NDArray[np.float64]]] = []
        self.records = [Moment(time.monotonic(), truth.on, truth.pulses_us)]

    @property
    def plugged(self) -> bool:
        """Whether the port exists."""
        return self.device.plugged and not self._is_out.is_set()

    @property
    def next_delivery_s(self) -> float:
        """When the next bytes are due; none are while the plug is out."""
        return _FOREVER if self._is_out.is_set() else self.device.next_delivery_s

    def unplug(self) -> None:
        """Pull the plug: servos keep their power, and go on as before."""
        self._is_out.set()

    def plug_in(self) -> None:
        """Plug the device in again: the port has a new name, to which the link leads."""
        self._is_out.clear()

    def advance(self, now_s: float) -> None:
        """Simulate until `now_s`, and log what has changed."""
        self.device.advance(now_s)
        if self._is_out.is_set():
            self.device.deliver(_FOREVER)
        self._note()

    def receive(self, data: bytes, now_s: float, baud_rate: int) -> None:
        """Obey bytes, and log what has changed; none come while the plug is out."""
        if not self._is_out.is_set():
            self.device.receive(data, now_s, baud_rate)
        self._note()

    def deliver(self, now_s: float) -> bytes:
        """The bytes that have reached the computer."""
        return self.device.deliver(now_s)

    def turn(self, index: int, by_deg: float) -> None:
        """Turn a limp servo's shaft as a hand would; do nothing if the simulator cannot."""
        if (turn := getattr(self.device, "turn", None)) is not None:
            turn(index, by_deg)

    def during(self, since_s: float, until_s: float) -> list[Moment]:
        """Return the records in force at some time from `since_s` to `until_s`: at least one.

        The first of them may be older than `since_s`. Times are monotonic seconds.
        """
        records = self.records
        first_after = bisect_right(records, since_s, key=lambda each: each.time_s)
        last_after = bisect_right(records, until_s, key=lambda each: each.time_s)
        return records[max(0, first_after - 1) : max(1, last_after)]

    def travelled_deg(self, since_s: float, until_s: float = _FOREVER) -> NDArray[np.float64]:
        """Return how far each shaft travelled between its extremes, (n_servos,) degrees."""
        angles_deg = [deg for time_s, deg in self.shafts if since_s <= time_s <= until_s]
        if not angles_deg:
            return np.zeros(len(self.truth.on))
        return np.asarray(np.ptp(np.array(angles_deg), axis=0))

    def _note(self) -> None:
        """Log torque and pulses if they have changed, and shafts every `_SHAFTS_EVERY_S`."""
        now_s, truth = time.monotonic(), self.truth
        on, pulses_us, last = truth.on, truth.pulses_us, self.records[-1]
        if on != last.on or pulses_us != last.pulses_us:
            self.records.append(Moment(now_s, on, pulses_us))
        if now_s - self._shafts_s >= _SHAFTS_EVERY_S:
            self._shafts_s = now_s
            self.shafts.append((now_s, truth.shafts_deg().copy()))
