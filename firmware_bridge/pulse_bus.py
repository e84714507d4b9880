"""The bus of hobby servos at a controller that makes their pulses: it starts without positions.

A channel without pulses jumps, at the servo's full speed, to wherever its first pulse sends it. So
servos come on one after another, each with the pulse that it had last (from the controller, else
from the face's file), and move slowly from there until they have caught up.
"""

import contextlib
import json
import os
import threading
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.bus import (
    CATCH_UP_DEG_S,
    GOAL_OUT_OF_RANGE,
    Array,
    Feedback,
    Health,
    Readings,
    all_set,
    any_set,
    check_shape,
)
from firmware_bridge.capabilities import BusCapabilities
from firmware_bridge.clock import Clock
from firmware_bridge.errors import PortError
from firmware_bridge.known_torque import SILENT_S, KnownTorque, Torque, unknown_when_lost
from firmware_bridge.pulse_servos import PulseScale, PulseServo

#: The state of a hobby servo without pulses, in words: it cannot report more.
PULSES_OFF: Final = "pulses off; a digital servo may hold"
#: Servos start so long after one another: a servo pulls at its hardest to its first pulse.
STAGGER_S: Final = 0.25
#: The controller is queried so often for the pulse that it sends, one channel at a time.
_LOOK_EVERY_S: Final = 0.2
#: A shorter silence of the controller is none: it is queried only now and then.
_SILENT_S: Final = 0.45
#: The pulse that a controller sends may differ so much from its goal: it may be on its way there.
_NEAR_US: Final = 100.0
#: Wrong first pulses after which a channel counts as wrong; a single one may be a lost packet.
_FAILURES: Final = 2
#: The pulses sent last are written to their file so often.
_KEEP_EVERY_S: Final = 1.0


def usb_product(port: str, sysfs: Path = Path("/sys")) -> str:
    """Return vendor and product of the USB device behind a port, as 1ffb:0089; empty: no device."""
    device = (sysfs / "class/tty" / Path(port).resolve().name / "device").resolve()
    for folder in (device, *device.parents):
        with contextlib.suppress(OSError):
            numbers = [(folder / name).read_text().strip() for name in ("idVendor", "idProduct")]
            return ":".join(numbers).lower()
    return ""


class PulseController(Protocol):
    """The device that makes the pulses of a face's hobby servos. Methods raise PortError."""

    def open(self) -> None:
        """Open the connection, also again after it was lost; sends no pulse."""

    def close(self) -> None:
        """Close the connection; pulses continue as they are."""

    def send(self, pulses_us: Array) -> bool:
        """Send the pulse of each servo in one write.

        Parameters
        ----------
        pulses_us : Array
            (n_servos,) us; 0: none.

        Returns
        -------
        bool
            False: the controller lost its state since the last write, as by a failure of its
            supply, and makes no pulse.
        """

    def sending(self, index: int) -> float:
        """Return the pulse in us that servo `index` gets now; 0: none, NaN: no answer."""

    @property
    def is_blocked(self) -> bool:
        """Whether no pulse reaches a servo, whatever `sending` returns."""

    def remarks(self) -> Sequence[str]:
        """Return remarks on unusual conditions, in sentences for a log."""


class KeptPulses:
    """The file of the pulses that a face sent last, by channel; written by a thread.

    It is empty for a face that has never sent a pulse: its servos' positions are unknown.
    """

    def __init__(self, path: Path | None) -> None:
        """Prepare to read and write the file at `path`, which may be absent; None: keep nothing."""
        self._path = path
        self._coming: dict[str, float] = {}
        self._written: dict[str, float] = {}
        self._is_over = threading.Event()
        self._thread: threading.Thread | None = None

    def read(self) -> Mapping[int, float]:
        """Return the pulses in us by channel; {} where the file is absent or unusable."""
        try:
            kept = json.loads(self._path.read_text()) if self._path else {}
            return {int(key): float(value) for key, value in kept["pulses_us"].items()}
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return {}

    def follow(self, channels: Sequence[int], sent_us: Array) -> None:
        """Start a thread that writes `sent_us` to the file about once a second, until `close`.

        Parameters
        ----------
        channels : Sequence[int]
            The channel of each servo.
        sent_us : Array
            (n_servos,) us, changed in place by its owner.
        """
        if self._path is None or self._thread is not None:
            return

        def write_all() -> None:
            is_over = False
            while not is_over:
                is_over = self._is_over.wait(_KEEP_EVERY_S)
                self.write(dict(zip(channels, sent_us.tolist(), strict=True)))

        self._is_over.clear()
        self._thread = threading.Thread(target=write_all, name="kept pulses", daemon=True)
        self._thread.start()

    def write(self, pulses_us: Mapping[int, float]) -> None:
        """Write pulses in us by channel, completely or not at all; ignore errors of the disk."""
        known = {str(key): round(value, 2) for key, value in pulses_us.items() if value > 0.0}
        if self._path is None or known in ({}, self._written):
            return
        # Written beside the file, then moved over it, so that the file is whole at any time.
        coming = self._path.with_name(f".{self._path.name}.{os.getpid()}")
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            coming.write_text(json.dumps({"version": 1, "pulses_us": known}))
            coming.replace(self._path)
            self._written = known
        except OSError:
            with contextlib.suppress(OSError):
                coming.unlink()

    def close(self) -> None:
        """Have the thread write a last time, and wait for it, 1 s at most."""
        if self._thread is not None:
            self._is_over.set()
            self._thread.join(_KEEP_EVERY_S)
            self._thread = None


@unknown_when_lost
class PulseBus:
    """All hobby servos of one face behind one controller, as a `ServoBus`.

    `torque` is what the controller reports: a servo is on while the controller sends it pulses, off
    while it sends none, and unknown while the servo waits for its turn to start. A servo that gets
    pulses already when the port is opened goes on getting them as they are, until it is started or
    switched off.
    """

    def __init__(
        self,
        servos: Sequence[PulseServo],
        controller: PulseController,
        clock: Clock,
        capabilities: BusCapabilities,
        kept: KeptPulses | None = None,
        *,
        may_jump: bool = False,
    ) -> None:
        """Prepare the bus; `with` opens it.

        kept: the pulses sent last by earlier processes; None: none. may_jump: whether a servo of
        unknown position may start at neutral without permission.
        """
        n = len(servos)
        self.capabilities = capabilities
        self._channels = tuple(each.address for each in servos)
        self._scale = scale = PulseScale(servos)
        self._controller, self._clock, self._may_jump = controller, clock, may_jump
        self._kept = kept or KeptPulses(None)
        self._low_us, self._high_us = scale.min_us, scale.max_us
        self._slow_us_s = np.minimum(CATCH_UP_DEG_S * np.abs(scale.us_per_deg), scale.max_us_s)
        # (n,) each. Held: started by `enable_torque`; its turn, perhaps yet to come, is at `_on_s`.
        # Slow: held, and has not caught up with its goal.
        self._held = np.zeros(n, dtype=np.bool_)
        self._pulsed = np.zeros(n, dtype=np.bool_)  # by the last write that was accepted
        self._slow = np.zeros(n, dtype=np.bool_)
        self._on_s = np.full(n, np.inf)
        self._left_on = np.zeros(n, dtype=np.bool_)  # not started by us, and gets pulses
        # The pulses sent last, by any process; file and status read this array, changed in place.
        self._last_us = np.full(n, np.nan)
        self.torque = KnownTorque(n, self._last_us)
        self._start_us = scale.neutral_us.copy()  # of those that come on: their first pulse
        self._goal_us = scale.neutral_us.copy()
        self._wrong, self._n_failed = [""] * n, np.zeros(n, dtype=np.int64)
        self._errors = self._no_errors = np.zeros(n, dtype=np.uint8)
        self._nothing, self._unknown = np.zeros(n), np.full(n, np.nan)
        self._health = Health(
            silent_s=self._nothing,
            torque=self.torque.states,
            watchdog_tripped=np.zeros(n, dtype=np.bool_),
            hardware_errors=self._no_errors,
            temperature_degc=self._unknown,
            room_degc=np.full(n, np.inf),
            voltage_v=self._unknown,
            effort=self._unknown,
            current_ma=self._unknown,
            n_unanswered=np.zeros(n, dtype=np.int64),
        )
        self._sent_s = self._look_s = self._heard_s = self._turn_s = 0.0
        self._next = 0
        self._is_open = self._has_sent = self._is_steady = False

    def write_positions(self, positions_deg: Array) -> None:
        """Set every servo's goal, and send pulses to the servos that have been started.

        A goal beyond a servo's pulses is skipped: it keeps the goal before, and its error is
        `GOAL_OUT_OF_RANGE`.

        Parameters
        ----------
        positions_deg : Array
            (n_servos,) joint degrees.

        Raises
        ------
        ValueError
            positions_deg has another shape.
        """
        check_shape(positions_deg, self._goal_us.shape)
        self._check_open()
        scale = self._scale
        pulses_us = scale.pulses_us(positions_deg)
        above, below = pulses_us >= self._low_us, pulses_us <= self._high_us
        if all_set(above) and all_set(below):
            self._errors = self._no_errors
        else:
            taken = above & below
            pulses_us = np.where(taken, pulses_us, self._goal_us)
            self._errors = np.where(taken, self._no_errors, np.uint8(GOAL_OUT_OF_RANGE))
        self._goal_us = pulses_us
        self._send()

    def widen(self, joints: NDArray[np.bool_]) -> None:
        """Accept goals beyond min_us..max_us, as far as `reach_us`, for the given servos only.

        Parameters
        ----------
        joints : NDArray[np.bool_]
            (n_servos,): True for servos that may go beyond.
        """
        low_us, high_us = self._scale.reach_us.T
        self._low_us = np.where(joints, low_us, self._scale.min_us)
        self._high_us = np.where(joints, high_us, self._scale.max_us)

    def read(self) -> Readings:
        """Return the goals that were sent; positions are NaN, since hobby servos report none."""
        self._check_open()
        return Readings(
            time_s=self._clock.now(),
            positions_deg=self._unknown,
            goals_deg=self._scale.joints_deg(self._goal_us),
            torque=self.torque.states,
            errors=self._errors,
            age_s=self._nothing,
        )

    def feedback(self) -> Feedback:
        """Return unknown positions; unless all servos run steadily, also `ready` and `sent_deg`.

        ready: servos whose turn to start has come. sent_deg: the joint angle of each one's pulse.
        """
        self._check_open()
        now_s = self._clock.now()
        ready = sent_deg = None
        if not self._is_steady:
            ready = self._held & (self._on_s <= now_s)
            sent_us = np.where(self._slow, self._from_us, self._goal_us)
            sent_deg = self._scale.joints_deg(sent_us)
        unknown = self._unknown
        return Feedback(now_s, unknown, unknown, self._errors, self._nothing, ready, sent_deg)

    def remarks(self) -> Sequence[str]:
        """Return the controller's remarks for a log."""
        return self._controller.remarks()

    def look_after(self) -> Health:
        """Query the controller for one servo's pulse, every .2 s, in case its state was lost.

        Return the servos' health, of which only torque and the controller's silence are known. All
        torque is unknown after .5 s of silence.
        """
        self._check_open()
        now_s = self._clock.now()
        if now_s >= self._look_s:
            self._look_s = now_s + _LOOK_EVERY_S
            self._look(now_s)
        silent_s = now_s - self._heard_s
        if silent_s >= SILENT_S:
            self.torque.forget()
        if self._health.torque is not self.torque.states:
            self._health = replace(self._health, torque=self.torque.states)
        if silent_s < _SILENT_S:
            return self._health
        return replace(self._health, silent_s=np.full(len(self._channels), silent_s))

    def obstacle(self, index: int) -> str:
        """Return why servo `index` may not start; empty: it may.

        Reasons are an unknown position, and a channel that does not obey.
        """
        self._check_open()
        if not self._may_jump and np.isnan(self._last_us[index]):
            return (
                "has had no pulse yet, so its position is unknown: it will jump to neutral at "
                "full speed; keep clear, then allow it once: `lipservo calibrate neutral --yes`"
            )
        return self._wrong[index]

    def forgive(self, index: int) -> None:
        """Forget what was wrong with the channel of servo `index`: its next start finds out."""
        self._wrong[index], self._n_failed[index] = "", 0

    def enable_torque(self, index: int) -> str:
        """Start a servo's pulses, with the last pulse it had, .25 s or more after the servo before.

        Return "" if its start is accepted, which may lie ahead, else why it may not start. A servo
        without a known last pulse starts at neutral if it may jump, else it is refused. Then it
        moves slowly until it has caught up.
        """
        if why := self.obstacle(index):
            return why
        if self._held[index]:
            return ""
        last_us, scale, now_s = self._last_us[index], self._scale, self._clock.now()
        if np.isnan(last_us):
            last_us = scale.neutral_us[index]
        self._start_us[index] = np.clip(last_us, scale.min_us[index], scale.max_us[index])
        self._goal_us = self._goal_us.copy()
        self._goal_us[index] = self._start_us[index]
        # A servo that has pulses already need not wait for its turn.
        if self._left_on[index]:
            self._on_s[index] = now_s
            self._left_on[index] = False
        else:
            self._on_s[index] = max(now_s, self._turn_s)
            self._turn_s = self._on_s[index] + STAGGER_S
            self.torque.forget((index,))
        self._held[index] = self._slow[index] = True
        self._kept.follow(self._channels, self._last_us)
        self._sent_s = now_s
        self._send()
        return ""

    def keep_torque(self, index: int) -> bool:
        """Continue a servo's pulses if the controller still sends them; return whether it does."""
        self._check_open()
        sending_us = self._ask(index)
        is_off = sending_us == 0.0 or self._controller.is_blocked
        if is_off:  # the next write must not send it again
            self._held[index] = self._left_on[index] = self._is_steady = False
        if is_off or np.isnan(sending_us):
            return False
        self._last_us[index] = sending_us
        self._held[index] = self._is_steady = False
        self._left_on[index] = True
        return not self.enable_torque(index)

    def disable_torque(self, index: int) -> bool:
        """Stop the pulses of one servo; return whether the controller confirms that it sends none.

        Whether the servo is limp then is unknown.
        """
        self._check_open()
        self._release(np.arange(len(self._held)) == index)
        return self._ask(index) == 0.0

    def disable_all(self) -> NDArray[np.bool_]:
        """Stop the pulses of all servos; stop reading back once the controller does not answer.

        Returns
        -------
        NDArray[np.bool_]
            (n_servos,): True where the controller confirmed that it sends no pulse.
        """
        self._check_open()
        self._release(np.ones_like(self._held))
        off = np.zeros_like(self._held)
        for index in range(len(off)):
            sending_us = self._ask(index)
            if np.isnan(sending_us):
                break
            off[index] = sending_us == 0.0
        return off

    def reboot(self, index: int) -> None:
        """Stop the servo's pulses: a hobby servo cannot be restarted."""
        self.disable_torque(index)

    def reopen(self) -> None:
        """Open the connection to the controller again; its pulses continue meanwhile."""
        self._check_open()
        self._open()

    def _open(self) -> None:
        """Open the controller and read each channel's pulse: servos that get one keep it."""
        self._controller.open()
        self._wrong = [""] * len(self._wrong)
        self._n_failed[:] = 0
        self._heard_s = self._clock.now()
        try:
            self._begin()
        except BaseException:
            self._controller.close()  # what guards it must know that registers may be on
            raise

    def __enter__(self) -> Self:
        """Read the pulses that earlier processes sent last, and open the controller."""
        kept = self._kept.read()
        self._last_us[:] = [kept.get(channel, np.nan) for channel in self._channels]
        self._open()
        self._is_open = True
        return self

    def __exit__(self, *exc: object) -> None:
        """End all pulses, if any was sent from here; close the controller; write the pulse file."""
        try:
            if self._has_sent and self.torque.any_on is not False:
                self.disable_all()
        except PortError:
            pass  # the process that waits for the port reports it
        finally:
            self._is_open = False
            self._controller.close()
            self._kept.close()

    def _release(self, which: NDArray[np.bool_]) -> None:
        """End the pulses of some servos. which: (n_servos,), True for these.

        Their goals become their last pulses, from which they start again; torque is unknown until
        the controller is queried.
        """
        self._goal_us = np.where(which & self._pulsed, self._last_us, self._goal_us)
        self._is_steady = False
        self._held &= ~which
        self._left_on &= ~which
        self._slow &= ~which
        self._on_s[which] = np.inf
        self.torque.forget(np.flatnonzero(which).tolist())
        self._send()

    def _send(self) -> None:
        """Send pulses to servos whose turn to start has come, and 0 (no pulse) to all others.

        Started servos move slowly until they have caught up with their goals. Servos that had
        pulses when the port was opened, and were not started since, go on getting the same. If the
        controller has lost its state, all are marked off.
        """
        now_s = self._clock.now()
        if self._is_steady:
            self._sent_s = now_s
            if self._controller.send(self._goal_us):
                self._last_us[:] = self._goal_us
            else:
                self._begin_anew()
            return
        on = self._held & (self._on_s <= now_s)
        if any_set(self._slow):
            # From its last pulse, at first that of its start, each moves by what it may since then.
            from_us = self._from_us
            seconds = np.where(self._on_s <= self._sent_s, now_s - self._sent_s, 0.0)
            reach_us = self._slow_us_s * seconds
            near_us = np.clip(self._goal_us, from_us - reach_us, from_us + reach_us)
            due = on & self._slow
            sent_us = np.where(due, near_us, self._goal_us)
            self._slow &= ~(due & (sent_us == self._goal_us) & (self._on_s < self._sent_s))
        else:
            sent_us = self._goal_us
        sent_us, on = np.where(self._left_on, self._last_us, sent_us), on | self._left_on
        self._sent_s, self._has_sent = now_s, True
        changed = np.flatnonzero(on != self._pulsed).tolist()
        self.torque.forget(changed)
        if not self._controller.send(np.where(on, sent_us, 0.0)):
            self._begin_anew()
            return
        self._pulsed = on
        np.copyto(self._last_us, sent_us, where=on)
        self._is_steady = all_set(self._held) and all_set(on) and not any_set(self._slow)
        for index in changed:
            if on[index]:
                self._check_first(index)

    def _begin_anew(self) -> None:
        """Mark all servos as not started: the controller has lost its pulses, or will end them."""
        self._begin()
        self._left_on[:] = self._pulsed[:] = False

    def _begin(self) -> None:
        """Mark all servos as not started; those that get a pulse now are left with it.

        Goals become the pulses sent last, from which servos start.
        """
        self._held[:] = self._slow[:] = self._is_steady = False
        self._on_s[:] = np.inf
        self.torque.forget()
        for index in range(len(self._held)):
            sending_us = self._ask(index)
            if sending_us > 0.0:
                self._last_us[index] = sending_us
        self._pulsed = self.torque.states == Torque.ON
        self._left_on = self._pulsed.copy()
        self._goal_us = np.where(np.isnan(self._last_us), self._goal_us, self._last_us)

    def _look(self, now_s: float) -> None:
        """Query the pulse of the next servo in turn; act where it is not as it should be.

        A servo that should have a pulse and has none is marked as not started; if one that is
        not started has a pulse, all are sent again: 0, or its own where it was left on. now_s:
        monotonic.
        """
        on = self._held & (self._on_s <= now_s)
        self._next = index = (self._next + 1) % len(on)
        sending_us = self._ask(index)
        if not on[index]:
            if sending_us > 0.0 and not self._held[index] and self._has_sent:
                self._send()  # a packet was lost, or its pulses were left on
                self._ask(index)
        elif sending_us == 0.0:
            self._held[index] = self._is_steady = False

    def _check_first(self, index: int) -> None:
        """Query the pulse of a servo just started; if it is not the one sent, stop the servo.

        After two wrong pulses `obstacle` returns the reason, so that it is not started again.
        """
        sending_us = self._ask(index)
        if np.isnan(sending_us):
            return
        if sending_us > 0.0 and abs(sending_us - self._last_us[index]) <= _NEAR_US:
            self._n_failed[index] = 0
            return
        self._held[index] = self._is_steady = False
        self._send()
        self._ask(index)
        self._n_failed[index] += 1
        if self._n_failed[index] >= _FAILURES:
            self._wrong[index] = (
                f"was told a pulse of {self._last_us[index]:.0f} us, and the controller sends "
                f"{sending_us:.0f}: its channel is set for something else or for a narrower range, "
                "or is none of this model"
            )

    @property
    def _from_us(self) -> Array:
        """The pulse from which each servo moves on: its last one, or before that its first."""
        return np.where(self._pulsed, self._last_us, self._start_us)

    def _ask(self, index: int) -> float:
        """Return the pulse in us that the controller sends to a servo; NaN: no answer.

        It is evidence of the servo's torque, except while the servo waits for its turn.
        """
        sending_us, now_s = self._controller.sending(index), self._clock.now()
        if not np.isnan(sending_us):
            self._heard_s = now_s
            if not self._held[index] or self._on_s[index] <= now_s:
                is_on = sending_us > 0.0 and not self._controller.is_blocked
                self.torque.note(index, now_s, on=is_on)
        return sending_us

    def _check_open(self) -> None:
        if not self._is_open:
            raise PortError("the bus is used outside its `with` block")
