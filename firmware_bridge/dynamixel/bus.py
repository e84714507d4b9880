"""A face full of Dynamixel servos as one `ServoBus`, and how often it can be written and read."""

import struct
from collections.abc import Callable, Sequence
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.bus import Array, Feedback, Health, Readings, all_set, any_set
from firmware_bridge.dynamixel.control_table import CAPABILITIES, register
from firmware_bridge.dynamixel.mounting import MountedServo, identify_all
from firmware_bridge.dynamixel.present_state import PresentState
from firmware_bridge.dynamixel.torque import SoftStart, TorqueSwitch, Watchdogs
from firmware_bridge.dynamixel.wire import codec
from firmware_bridge.dynamixel.wire.codec import GoalWrite, Status, StatusError
from firmware_bridge.dynamixel.wire.line import Line
from firmware_bridge.dynamixel.wire.span_group import SpanGroup
from firmware_bridge.errors import PortError
from firmware_bridge.known_torque import KnownTorque, unknown_when_lost
from firmware_bridge.serial_servos.half_duplex import BITS_PER_BYTE
from firmware_bridge.serial_servos.mounting import Mounting
from firmware_bridge.transport import Transport

#: Sync write of goals; sync read of ten bytes, a frame each; one health read a cycle.
_WRITE, _WRITE_EACH = 14, 5
_ASK, _ASK_EACH, _ANSWER_EACH = 14, 1, 21
_HEALTH: Final = 14 + 11 + 35
#: What computer and adapter add to each of the two questions; one USB frame.
_TURNAROUND_S: Final = 0.001
#: Rates that servos and most adapters have.
USUAL_RATES: Final = (57_600, 115_200, 1_000_000, 2_000_000, 3_000_000, 4_000_000)


def cycle_s(
    n_servos: int, baud_rate: int, return_delay_s: float = 0.0, latency_s: float = 0.0
) -> float:
    """Return the seconds of one cycle: goals out, positions of all and health of one servo back.

    return_delay_s: how long a servo waits before it answers. latency_s: how long the adapter holds
    an answer back; a USB frame at least.
    """
    n_bytes = _WRITE + _ASK + _HEALTH + n_servos * (_WRITE_EACH + _ASK_EACH + _ANSWER_EACH)
    waits_s = 2 * max(_TURNAROUND_S, latency_s) + (n_servos + 1) * return_delay_s
    return n_bytes * BITS_PER_BYTE / baud_rate + waits_s


def slow_adapter(
    n_servos: int, baud_rate: int, rate_hz: float, latency_timer_ms: float | None
) -> str | None:
    """Return why an adapter is too slow for `rate_hz`, and the remedy; None: it is not, or unknown.

    latency_timer_ms: how long the adapter holds answers back, from
    `serial_transport.latency_timer_ms`, None = unknown; FTDI chips come with 16:
    https://github.com/ROBOTIS-GIT/DynamixelSDK/issues/302
    """
    tick_s = cycle_s(n_servos, baud_rate, latency_s=(latency_timer_ms or 0.0) * 1e-3)
    if latency_timer_ms is None or latency_timer_ms <= 1.0 or tick_s * rate_hz <= 1.0:
        return None
    return (
        f"at {latency_timer_ms:g} ms of adapter latency a tick takes {tick_s * 1e3:.0f} ms: "
        f"{rate_hz:g} Hz cannot be met; set the latency timer to 1 ms (docs/hardware.md)"
    )


def budget(
    n_servos: int, baud_rate: int, rate_hz: float, return_delay_s: float = 0.0
) -> str | None:
    """Return why `n_servos` at `baud_rate` cannot do `rate_hz` with feedback, and the remedy.

    None if they can. return_delay_s: how long each servo waits before it answers.
    """
    if cycle_s(n_servos, baud_rate, return_delay_s) * rate_hz <= 1.0:
        return None
    better = [r for r in USUAL_RATES if cycle_s(n_servos, r) * rate_hz <= 1.0]
    can_hz = 1.0 / cycle_s(n_servos, baud_rate, return_delay_s)
    remedy = f"set {better[0]:,} baud" if better else "use fewer servos or a lower rate"
    if return_delay_s and cycle_s(n_servos, baud_rate) * rate_hz <= 1.0:
        remedy = "set the return delay to 0"
    return (
        f"{n_servos} servos at {baud_rate:,} baud cannot do {rate_hz:g} Hz with feedback, "
        f"only {can_hz:.0f}: {remedy} (`lipservo setup-servos`)"
    )


_TORQUE, _GOAL = register("torque_enable").address, register("goal_position").address
_LEVEL = register("status_return_level").address
#: torque_enable .. bus_watchdog, and what lies between: health in one read.
_HEALTH_SIZE: Final = register("bus_watchdog").end - _TORQUE
_ERROR_AT: Final = register("hardware_error_status").address - _TORQUE
_WARMTH = register("present_input_voltage").address
_PRESENT = register("present_current").address
#: goal_position .. present_position
_MOTION_SIZE: Final = register("present_position").end - _GOAL
#: Torque off is said this often before it is checked: a lost packet must not keep a face stiff.
_LIMP_REPEATS: Final = 3
_ECHO: Final = "the adapter gives back what is sent to the servos; that is swallowed"
_NO_FAST: Final = (
    "a servo does not know Fast Sync Read (`lipservo doctor` names it); all are asked in the plain "
    "way, which takes longer"
)


@unknown_when_lost
class DynamixelBus:
    """Servos on one line, found by their ids, addressed in joint degrees.

    A servo that falls silent costs its own samples only. When the port fails every method raises
    PortGone until `reopen` succeeds. Never writes EEPROM.
    """

    capabilities: Final = CAPABILITIES

    def __init__(
        self,
        servos: Sequence[MountedServo],
        open_transport: Callable[[], Transport],
        *,
        watchdog_s: float = 0.1,
        strict: bool = True,
        make_line: Callable[[Any], Line] = Line,
        adapter_remark: Callable[[], str | None] = lambda: None,
    ) -> None:
        """Make a bus of these servos, closed until `__enter__`; then opened by `open_transport`.

        watchdog_s: how long servos go on without receiving a packet; 0 = for ever. strict: every
        servo must answer before the first goal; otherwise servos may be missing, but neither a
        critical one nor all. make_line: makes the line at an open transport; `SdkLine` leaves the
        packets to dynamixel-sdk. adapter_remark: called once the port is open; returns a remark on
        the adapter for `remarks`, None if it has none.
        """
        self._make_line = make_line
        self._adapter_remark = adapter_remark
        self._remarks: tuple[str, ...] = ()
        self._servos = tuple(servos)
        self._ids = [servo.joint.servo_id for servo in servos]
        self._open_transport = open_transport
        self._watchdogs = Watchdogs(self._ids, watchdog_s)
        self._strict = strict
        self._mounting = Mounting(servos)
        self._present = PresentState(servos)
        self._cache = self._present.cache
        self._index = self._cache.index
        self._soft_start = SoftStart(servos)
        self._goal_write = GoalWrite(self._ids, _GOAL)
        self._motion = SpanGroup(self._ids, _PRESENT, 10)
        self._whole = SpanGroup(self._ids, _GOAL, _MOTION_SIZE)
        self._holding = SpanGroup(self._ids, _TORQUE, 1)
        self._groups = (self._motion, self._whole, self._holding)
        self._torque = TorqueSwitch(
            servos, self._present, self._mounting, self._soft_start, self._watchdogs
        )
        self._turn = 0
        self._line: Line | None = None

    @property
    def torque(self) -> KnownTorque:
        """What is known of every servo's torque, from reads of its register alone."""
        return self._cache.torque

    @property
    def at_full_strength(self) -> bool:
        """Whether every servo with torque on has been set to its full speed and current."""
        return not self._soft_start.is_active

    @property
    def line(self) -> Line:
        """The open line. Raises PortError when no line is open."""
        if self._line is None:
            raise PortError("the bus is used outside its `with` block, or its port is gone")
        return self._line

    def write_positions(self, positions_deg: Array) -> None:
        """Send every goal inside its servo's own range; skip NaN and goals outside the range.

        Parameters
        ----------
        positions_deg : Array
            (n_servos,) joint degrees.

        Raises
        ------
        ValueError
            positions_deg has another shape.
        """
        if positions_deg.shape != self._cache.goals.shape:
            raise ValueError(
                f"expected positions of shape {self._cache.goals.shape}, got {positions_deg.shape}"
            )
        line = self._line or self.line  # the property raises
        pulses = self._mounting.pulses(positions_deg)
        taken = (self._cache.low <= pulses) & (pulses <= self._cache.high)
        if all_set(taken):
            self._cache.errors = self._cache.no_errors
            self._watchdogs.keep(line)
            self._cache.goals = pulses
            line.tell(self._goal_write.request(pulses))
            return
        self._cache.errors = np.where(taken, 0, StatusError.DATA_LIMIT).astype(np.uint8)
        if not any_set(taken):
            return
        self._watchdogs.keep(line)
        self._cache.goals = np.where(taken, pulses, self._cache.goals)
        blocks = [(self._ids[n], struct.pack("<i", int(pulses[n]))) for n in np.flatnonzero(taken)]
        line.tell(codec.sync_write(_GOAL, 4, blocks))

    def widen(self, joints: NDArray[np.bool_]) -> None:
        """Do nothing: only hobby servos accept goals beyond their joints' limits.

        Parameters
        ----------
        joints : NDArray[np.bool_]
            (n_servos,), ignored.
        """

    def read(self) -> Readings:
        """Read goals and positions of all servos, then whether their torque is on.

        For a servo that does not answer: its last position, with its age, and NaN as its goal.
        """
        line = self.line
        found = self._note(self._whole.ask(line))
        for status in found:
            n = self._index[status.servo_id]
            goal, place = struct.unpack_from("<i12xi", status.data)
            self._cache.goals[n], self._cache.pulses[n] = goal, place
        held = self._holding.ask(line)
        now_s = line.transport.clock.now()
        for status in held:
            self._torque.note(self._index[status.servo_id], status.data, now_s)
        ages_s = self._cache.ages([status.servo_id for status in found], now_s)
        # A goal counts as read only when it was: whoever arms relies on it.
        goals = np.where(ages_s > 0.0, np.nan, self._cache.goals)
        return Readings(
            time_s=now_s,
            positions_deg=self._mounting.joint_deg(self._cache.pulses),
            goals_deg=self._mounting.joint_deg(goals),
            torque=self._cache.torque.states,
            errors=self._cache.errors,
            age_s=ages_s,
        )

    def feedback(self) -> Feedback:
        """Read position and load of every servo; of silent ones the last values, with their age."""
        line = self._line or self.line
        found = self._motion.ask(line)
        now_s = line.transport.clock.now()
        self._watchdogs.spoke(now_s)
        ages_s = self._present.take_motion(found, now_s)
        return Feedback(
            time_s=now_s,
            positions_deg=self._mounting.joint_deg(self._cache.pulses),
            effort=self._cache.effort,
            errors=self._cache.errors,
            age_s=ages_s,
        )

    def look_after(self) -> Health:
        """Read torque, errors and watchdog of one servo, or its temperature and voltage, in turns.

        Also ends soft starts that are due. Return the last readings of all servos.
        """
        line, cache = self._line or self.line, self._cache
        turn, kind = divmod(self._turn, 2)
        self._turn = (self._turn + 1) % (2 * len(self._ids))
        servo_id = self._ids[turn]
        if kind == 0:
            status = line.read(servo_id, _TORQUE, _HEALTH_SIZE)
            if status is not None and len(status.data) == _HEALTH_SIZE:
                self._torque.note(turn, status.data, line.transport.clock.now())
                cache.set_one("hardware", turn, status.data[_ERROR_AT])
                cache.set_one("tripped", turn, status.data[-1] == 0xFF)
                self._torque.renew_watchdog(line, turn, status.data[-1])
        else:
            status = line.read(servo_id, _WARMTH, 3)
            if status is not None and len(status.data) == 3:
                cache.set_one("voltage_v", turn, int.from_bytes(status.data[:2], "little") / 10.0)
                self._present.take_temperature(turn, status.data[2])
        if status is not None:
            now_s = line.transport.clock.now()
            self._watchdogs.spoke(now_s)
            self._present.note([status], now_s)
            for group in self._groups:
                if group.leaves_out:
                    group.trust(servo_id)
        self._soft_start.restore_full_limits(line)
        return cache.health(line.transport.clock.now(), self._present.current_ma)

    def obstacle(self, index: int) -> str:
        """Return why servo `index` cannot hold its position; empty: it can.

        Read anew before torque comes on: the servo may have been replaced, or set up elsewhere.
        """
        return self._torque.obstacle(self.line, index)

    def enable_torque(self, index: int) -> str:
        """Switch one servo's torque on without motion; return why it stays off, "" if confirmed.

        Checked or set in this order, each read back before the next: identity, position, watchdog,
        goal, slow start, torque.
        """
        return self._torque.enable(self.line, index)

    def keep_torque(self, index: int) -> bool:
        """Hold a servo whose torque is on at its present position; return whether it confirmed."""
        return self._torque.keep(self.line, index)

    def disable_torque(self, index: int) -> bool:
        """Switch one servo's torque off; return whether a read confirms it."""
        return self._torque.disable(self.line, index)

    def disable_all(self) -> NDArray[np.bool_]:
        """Broadcast torque off three times, then read it from each servo until it confirms.

        Returns
        -------
        NDArray[np.bool_]
            (n_servos,): True for servos that confirmed.
        """
        line = self.line
        self._soft_start.cancel()
        self._cache.torque.forget()
        request = codec.sync_write(_TORQUE, 1, [(each, b"\0") for each in self._ids])
        for _ in range(_LIMP_REPEATS):
            line.tell(request)
        confirmed = np.zeros(len(self._ids), dtype=np.bool_)
        self._holding.reset()  # everybody is asked, also who was silent lately
        for _ in range(_LIMP_REPEATS):
            for status in self._note(self._holding.ask(line)):
                n = self._index[status.servo_id]
                confirmed[n] = status.data == b"\0"
                self._torque.note(n, status.data, line.transport.clock.now())
            if confirmed.all():
                break
            line.tell(request)
        self._cache.enabled &= ~confirmed
        return confirmed

    def remarks(self) -> Sequence[str]:
        """Return what is unusual about adapter and servos, in sentences for a log."""
        if self._line is not None and self._line.echoes and _ECHO not in self._remarks:
            self._remarks += (_ECHO,)
        if any(each.fast_unsupported for each in self._groups) and _NO_FAST not in self._remarks:
            self._remarks += (_NO_FAST,)
        return self._remarks

    def reboot(self, index: int) -> None:
        """Restart one servo; forget the hardware error and watchdog trip read from it."""
        self._cache.torque.forget((index,))
        self.line.reboot(self._ids[index])
        self._cache.set_one("hardware", index, 0)
        self._cache.set_one("tripped", index, False)

    def reopen(self) -> None:
        """Open the port again with a new handle. Raises PortError."""
        self._close()
        self._begin(self._open_line())

    def __enter__(self) -> Self:
        line = self._open_line()
        try:
            identities = identify_all(line, self._servos, strict=self._strict)
        except BaseException:
            line.transport.close()
            raise
        for n, answer in enumerate(identities):
            if answer is not None:
                self._present.take_identity(n, answer, line.transport.clock.now())
        self._begin(line)
        slow = self._adapter_remark()
        self._remarks = () if slow is None else (slow,)
        return self

    def __exit__(self, *exc: object) -> None:
        try:
            if self._line is not None and self._cache.enabled.any():
                self.disable_all()
        except PortError:
            pass  # nobody to tell; the servos' own watchdog stops them
        finally:
            self._close()

    def _open_line(self) -> Line:
        return self._make_line(self._open_transport())

    def _begin(self, line: Line) -> None:
        """Use `line` from now on, with the answer deadline that the slowest servo needs.

        All servos are set to answer every instruction, counts of unanswered reads start anew, and
        nothing is known of torque.
        """
        self._line = line
        self._cache.torque.forget()
        line.return_delay_s = float(self._cache.return_delay_s.max())
        line.tell(codec.sync_write(_LEVEL, 1, [(each, b"\2") for each in self._ids]))
        for group in self._groups:
            group.reset()

    def _close(self) -> None:
        if self._line is not None:
            self._line.transport.close()
            self._line = None

    def _note(self, statuses: Sequence[Status]) -> Sequence[Status]:
        """Store which servos answered just now and the errors they reported; return `statuses`."""
        now_s = self.line.transport.clock.now()
        self._watchdogs.spoke(now_s)
        self._present.note(statuses, now_s)
        return statuses
