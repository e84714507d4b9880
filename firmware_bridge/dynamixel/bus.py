"""A face full of Dynamixel servos as one `ServoBus`, and how often it can be written and read."""

import struct
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final

import numpy as np

from firmware_bridge.bus import Array, Feedback, Health, Readings, all_set, any_set, check_shape
from firmware_bridge.dynamixel.control_table import CAPABILITIES, register
from firmware_bridge.dynamixel.mounting import MountedServo, identify_all
from firmware_bridge.dynamixel.present_state import PresentState
from firmware_bridge.dynamixel.torque import SoftStart, TorqueSwitch, Watchdogs
from firmware_bridge.dynamixel.wire import codec
from firmware_bridge.dynamixel.wire.codec import GoalWrite, Status, StatusError
from firmware_bridge.dynamixel.wire.line import Line
from firmware_bridge.dynamixel.wire.span_group import SpanGroup
from firmware_bridge.known_torque import unknown_when_lost
from firmware_bridge.serial_servos.bus import SerialBus
from firmware_bridge.serial_servos.half_duplex import BITS_PER_BYTE
from firmware_bridge.transport import Transport

#: Bytes of the packets of a cycle, in all and for each servo: sync write of goals; sync read of ten
#: bytes, a frame for each servo; one read of health.
_WRITE, _WRITE_EACH = 14, 5
_ASK, _ASK_EACH, _ANSWER_EACH = 14, 1, 21
_HEALTH: Final = 14 + 11 + 35
#: What computer and adapter add to each of the two reads; one USB frame.
_TURNAROUND_S: Final = 0.001
#: Rates that servos and most adapters have.
USUAL_RATES: Final = (57_600, 115_200, 1_000_000, 2_000_000, 3_000_000, 4_000_000)


def cycle_s(
    n_servos: int, baud_rate: int, return_delay_s: float = 0.0, latency_s: float = 0.0
) -> float:
    """Return the seconds of one cycle: goals out, positions of all and health of one servo back.

    Computed from the bytes of plain (not fast) sync reads. return_delay_s: how long a servo waits
    before it answers. latency_s: how long the adapter holds an answer back; at least a USB frame is
    counted.
    """
    n_bytes = _WRITE + _ASK + _HEALTH + n_servos * (_WRITE_EACH + _ASK_EACH + _ANSWER_EACH)
    waits_s = 2 * max(_TURNAROUND_S, latency_s) + (n_servos + 1) * return_delay_s
    return n_bytes * BITS_PER_BYTE / baud_rate + waits_s


def slow_adapter(
    n_servos: int, baud_rate: int, rate_hz: float, latency_timer_ms: float | None
) -> str | None:
    """Return why an adapter is too slow for `rate_hz` ticks a second, and the remedy; else None.

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

    None if they can. rate_hz: ticks a second, in each of which all positions are read.
    return_delay_s: how long each servo waits before it answers.
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
#: Bytes from torque_enable to bus_watchdog: torque, errors and watchdog in one read.
_HEALTH_SIZE: Final = register("bus_watchdog").end - _TORQUE
_ERROR_AT: Final = register("hardware_error_status").address - _TORQUE
_WARMTH = register("present_input_voltage").address
_PRESENT = register("present_current").address
#: goal_position .. present_position
_MOTION_SIZE: Final = register("present_position").end - _GOAL
_NO_FAST: Final = (
    "a servo does not know Fast Sync Read (`lipservo doctor` names it); all are asked in the plain "
    "way, which takes longer"
)


@unknown_when_lost
class DynamixelBus(SerialBus[Line]):
    """Servos on one line, found by their ids, addressed in joint degrees.

    A servo that falls silent costs its own samples only. When the port fails every method raises
    PortGone until `reopen` succeeds. Never writes EEPROM.
    """

    capabilities: Final = CAPABILITIES
    _torque: TorqueSwitch
    _present: PresentState

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
        the adapter for the log, or None.
        """
        super().__init__(
            servos, lambda: make_line(open_transport()), PresentState(servos), strict=strict
        )
        self._adapter_remark = adapter_remark
        self._watchdogs = Watchdogs(self._ids, watchdog_s)
        self._soft_start = SoftStart(servos)
        self._goal_write = GoalWrite(self._ids, _GOAL)
        # Reads of all servos: current to position (10 bytes), goal to position, torque_enable.
        self._motion = SpanGroup(self._ids, _PRESENT, 10)
        self._whole = SpanGroup(self._ids, _GOAL, _MOTION_SIZE)
        self._holding = SpanGroup(self._ids, _TORQUE, 1)
        self._groups = (self._motion, self._whole, self._holding)
        self._torque = TorqueSwitch(
            servos, self._present, self._mounting, self._soft_start, self._watchdogs
        )

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
        check_shape(positions_deg, self._cache.goals.shape)
        line = self._line or self.line  # the property raises
        pulses = self._mounting.pulses(positions_deg)
        # NaN is in no range.
        taken = (self._cache.low <= pulses) & (pulses <= self._cache.high)
        if all_set(taken):  # the usual case, for which a packet is prepared
            self._watchdogs.keep(line)
            self._cache.set_goals(pulses)
            line.tell(self._goal_write.request(pulses))
            return
        self._cache.set_goals(pulses, taken, StatusError.DATA_LIMIT)
        if not any_set(taken):
            return
        self._watchdogs.keep(line)
        blocks = [(self._ids[n], struct.pack("<i", int(pulses[n]))) for n in np.flatnonzero(taken)]
        line.tell(codec.sync_write(_GOAL, 4, blocks))

    def read(self) -> Readings:
        """Read goals and positions of all servos, then whether their torque is on.

        For a servo that does not answer: its last position, with its age, and NaN as its goal.
        """
        line = self.line
        found = self._note(self._whole.ask(line))
        for status in found:
            n = self._index[status.servo_id]
            # goal_position, 12 bytes of other registers, present_position
            goal, place = struct.unpack_from("<i12xi", status.data)
            self._cache.goals[n], self._cache.pulses[n] = goal, place
        held = self._holding.ask(line)
        now_s = line.transport.clock.now()
        for status in held:
            self._torque.note(self._index[status.servo_id], status.data, now_s)
        ages_s = self._cache.ages([status.servo_id for status in found], now_s)
        # A goal that was not read just now is unknown: switching torque on relies on it.
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
        """Read position and load of every servo; return the last values, with age, of silent ones.

        Called in every tick. Raises PortError.
        """
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
        """Read the condition of the next servo in turn; return the last readings of all servos.

        Called in every tick: in one it reads a servo's torque, errors and watchdog, in the next its
        voltage and temperature. Also ends soft starts that are due.
        """
        line, cache = self._line or self.line, self._cache
        # turn: index of the servo; kind: which of the two reads
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
            # A servo that answers again is included again in the reads that left it out.
            for group in self._groups:
                if group.leaves_out:
                    group.trust(servo_id)
        self._soft_start.restore_full_limits(line)
        return cache.health(line.transport.clock.now(), self._present.current_ma)

    def remarks(self) -> Sequence[str]:
        """Return what is unusual about adapter and servos, in sentences for a log."""
        super().remarks()
        if any(each.fast_unsupported for each in self._groups) and _NO_FAST not in self._remarks:
            self._remarks += (_NO_FAST,)
        return self._remarks

    def reboot(self, index: int) -> None:
        """Restart one servo; forget the hardware error and watchdog trip read from it."""
        self._cache.torque.forget((index,))
        self.line.reboot(self._ids[index])
        self._cache.set_one("hardware", index, 0)
        self._cache.set_one("tripped", index, False)

    def _identities(self, line: Line) -> Sequence[Any]:
        return identify_all(line, self._servos, strict=self._strict)

    def _first_remarks(self) -> Iterable[str]:
        slow = self._adapter_remark()
        return () if slow is None else (slow,)

    def _all_off(self) -> bytes:
        return codec.sync_write(_TORQUE, 1, [(each, b"\0") for each in self._ids])

    def _ask_torque(self, line: Line) -> Iterable[Status]:
        return self._note(self._holding.ask(line))

    def _begin(self, line: Line) -> None:
        """Use `line` from now on; all servos are set to answer every instruction."""
        super()._begin(line)
        line.tell(codec.sync_write(_LEVEL, 1, [(each, b"\2") for each in self._ids]))

    def _note(self, statuses: Sequence[Status]) -> Sequence[Status]:
        """Store which servos answered just now and the errors they reported; return `statuses`."""
        now_s = self.line.transport.clock.now()
        self._watchdogs.spoke(now_s)
        self._present.note(statuses, now_s)
        return statuses
