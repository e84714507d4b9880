"""A face full of Feetech servos as one `ServoBus`, and how often it can be written and read."""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final

import numpy as np

from firmware_bridge.bus import (
    GOAL_OUT_OF_RANGE,
    Array,
    Feedback,
    Health,
    Readings,
    all_set,
    any_set,
    check_shape,
)
from firmware_bridge.capabilities import SERIAL_SERVOS
from firmware_bridge.feetech import codec
from firmware_bridge.feetech.codec import EMPTY_SIZE, GoalWrite, SpanRead, Status, statuses_in
from firmware_bridge.feetech.control_table import CONTROL, STATE, TORQUE_ENABLE, Dialect
from firmware_bridge.feetech.line import Answers, Group, Line
from firmware_bridge.feetech.mounting import MountedServo, identify_all
from firmware_bridge.feetech.present_state import PresentState
from firmware_bridge.feetech.torque import TorqueSwitch
from firmware_bridge.joints import named
from firmware_bridge.known_torque import Torque, unknown_when_lost
from firmware_bridge.serial_servos.bus import SerialBus
from firmware_bridge.serial_servos.half_duplex import BITS_PER_BYTE
from firmware_bridge.transport import Transport

#: What computer and adapter add to a request; one USB frame.
_TURNAROUND_S: Final = 0.001
#: Bytes of a request to one servo, and of a sync write or read without its servos.
_ASK_ONE, _ASK_ALL = 8, 8
#: A servo's speed is this many times that of its goals, so that it arrives well before the next
#: goal; after a fast goal its speed falls by a tenth from tick to tick.
_SPEED_MARGIN, _SPEED_KEPT = 2.0, 0.9
#: Without sync read, this many servos that answer again after a silence are read in one tick.
_AT_ONCE: Final = 3


def cycle_s(n_servos: int, baud_rate: int, dialect: Dialect) -> float:
    """Return the seconds of one cycle: goals out, state of all and control of one servo back.

    State: position, load, voltage, temperature and errors, the registers from `STATE` on. Control:
    torque and goals, the registers from `CONTROL` on.
    """
    write = _ASK_ALL + 7 * n_servos
    answer = EMPTY_SIZE + dialect.state_size
    state = n_servos * answer + (_ASK_ALL + n_servos if dialect.sync_read else n_servos * _ASK_ONE)
    n_questions = 2 if dialect.sync_read else n_servos + 1
    control = _ASK_ONE + EMPTY_SIZE + dialect.control_size
    return (write + state + control) * BITS_PER_BYTE / baud_rate + n_questions * _TURNAROUND_S


def budget(servos: Sequence[MountedServo], baud_rate: int, rate_hz: float) -> str | None:
    """Return why `servos` at `baud_rate` cannot do `rate_hz` with feedback, and the remedy.

    None if they can. rate_hz: ticks a second, in each of which all positions are read.
    """
    dialect = servos[0].model.dialect
    can_hz = 1.0 / cycle_s(len(servos), baud_rate, dialect)
    if can_hz >= rate_hz:
        return None
    faster = cycle_s(len(servos), 1_000_000, dialect) * rate_hz <= 1.0
    remedy = "set 1,000,000 baud" if faster else "use fewer servos or a lower rate"
    return (
        f"{len(servos)} servos at {baud_rate:,} baud cannot do {rate_hz:g} Hz with feedback, "
        f"only {can_hz:.0f}: {remedy} (`lipservo setup-servos`)"
    )


@unknown_when_lost
class FeetechBus(SerialBus[Line]):
    """Servos of one dialect on one line, found by their ids, addressed in joint degrees.

    A servo that falls silent costs its own samples only. When the port fails every method raises
    PortGone until `reopen` succeeds. Never writes EEPROM, nor a goal to a servo that is to be limp.

    A servo that restarts forgets its speed, and its next goal switches its torque on. So each goal
    brings a speed, no more than the goal's own motion needs; and a servo that misses one answer
    gets no goals until it was read that it has not restarted.
    """

    capabilities: Final = SERIAL_SERVOS
    _torque: TorqueSwitch
    _present: PresentState

    def __init__(
        self,
        servos: Sequence[MountedServo],
        open_transport: Callable[[], Transport],
        *,
        strict: bool = True,
        period_s: float = math.inf,
    ) -> None:
        """Make a bus of these servos, closed until `__enter__`; then opened by `open_transport`.

        strict: every servo must answer before the first goal; otherwise servos may be missing, but
        neither a critical one nor all. period_s: from tick to tick. A servo whose goals were
        withheld moves at most as far as its top speed allows in one period per goal, or one step,
        however late the goal comes.
        """
        super().__init__(
            servos, lambda: Line(open_transport()), PresentState(servos), strict=strict
        )
        self._period_s = period_s
        self._dialect = dialect = servos[0].model.dialect
        self._torque = TorqueSwitch(servos, self._present, self._mounting)
        self._goal = dialect.registers["goal_position"].address
        self._goal_write = self._goals_to(self._ids)
        self._state = self._group(STATE, dialect.state_size)
        self._whole = self._group(CONTROL, STATE - CONTROL + dialect.state_size)
        self._holding = self._group(TORQUE_ENABLE, 1)
        self._groups = (self._state, self._whole, self._holding)
        #: Goals sent last, in pulses, and when; which servos still approach goals withheld before.
        self._sent = np.full(len(self._ids), np.nan)
        self._sent_s = 0.0
        self._behind = np.zeros(len(self._ids), dtype=np.bool_)
        self._top_pulses_s = np.array(
            [s.joint.max_speed_deg_s * s.model.pulses_per_deg for s in servos]
        )
        #: The goal_speed values that the latest goals needed.
        self._needed = np.zeros(len(self._ids))

    def _group(self, address: int, size: int) -> Group:
        return Group(self._ids, address, size, sync=self._dialect.sync_read)

    def _goals_to(self, ids: Sequence[int]) -> GoalWrite:
        return GoalWrite(ids, self._goal, self._dialect.byte_order)

    def write_positions(self, positions_deg: Array) -> None:
        """Send every goal inside its servo's range, with a speed; skip servos that must stay limp.

        Skipped, too, are servos that missed an answer, until a read shows that they have not
        restarted; afterwards they approach their goals at the joint's top speed.

        Parameters
        ----------
        positions_deg : Array
            (n_servos,) joint degrees.

        Raises
        ------
        ValueError
            positions_deg has another shape.
        """
        cache = self._cache
        check_shape(positions_deg, cache.goals.shape)
        line = self._line or self.line  # the property raises
        pulses = self._mounting.pulses(positions_deg)
        taken = (cache.low <= pulses) & (pulses <= cache.high)
        # driven: servos that get goals; doubted: those whose goals are withheld
        torque, since_s = self._torque, self._sent_s
        self._sent_s = line.transport.clock.now()
        if all_set(taken):
            cache.set_goals(pulses)
            if all_set(torque.driven) and not any_set(self._behind):
                line.tell(self._goal_write.request(pulses, self._speeds(pulses, since_s)))
                self._sent = pulses
                return
        else:
            cache.set_goals(pulses, taken, GOAL_OUT_OF_RANGE)
        # A servo whose goals were withheld gets goals at most `reach` from the last one sent to it;
        # a step at least, or a slow joint would never arrive.
        self._behind = (self._behind | torque.doubted) & (torque.doubted | torque.driven)
        reach = np.trunc(self._top_pulses_s * min(self._sent_s - since_s, self._period_s))
        reach = np.maximum(reach, 1.0)
        near = np.clip(cache.goals, self._sent - reach, self._sent + reach)
        goals = np.where(self._behind, near, cache.goals)
        self._behind &= torque.doubted | (goals != cache.goals)
        speeds = self._speeds(goals, since_s)
        self._sent = np.where(torque.doubted, self._sent, goals)
        sent = np.flatnonzero(taken & torque.driven)
        if len(sent):
            some = self._goals_to([self._ids[n] for n in sent.tolist()])
            line.tell(some.request(goals[sent], speeds[sent]))

    def _speeds(self, goals: Array, since_s: float) -> Array:
        """Return the goal_speed values to send with `goals`; arrays are (n_servos,).

        goals: position register values. since_s: when the last goals were sent. Twice the speed of
        the goal's own motion, at least that of a soft start, at most the joint's top speed.
        """
        torque, seconds = self._torque, min(self._sent_s - since_s, self._period_s)
        margin = _SPEED_MARGIN / max(seconds, _TURNAROUND_S)
        now = np.abs(goals - self._sent) * (torque.units * margin)
        # fmax: `now` is NaN before a first goal was sent.
        self._needed = np.fmax(now, self._needed * _SPEED_KEPT)
        return np.minimum(np.maximum(self._needed, torque.slow), torque.top)

    def read(self) -> Readings:
        """Read torque, goals and positions of all servos; return what was read.

        The goal of a limp servo is the last one from `write_positions`, if any, not its register;
        the goal of a servo that does not answer is NaN.
        """
        line, cache = self.line, self._cache
        found = self._whole.ask(line)
        statuses = _statuses(found)
        now_s = line.transport.clock.now()
        # The data begin at `CONTROL` with register torque_enable, and end with the state.
        goals = np.full(len(self._ids), np.nan)
        for status in statuses:
            n = self._index[status.servo_id]
            held = status.data[0] != 0
            cache.torque.note(n, now_s, on=held)
            if held or np.isnan(cache.goals[n]):
                cache.goals[n] = self._dialect.decode("goal_position", status.data, CONTROL)
            goals[n] = cache.goals[n]
        cut = STATE - CONTROL
        states = [Status(each.servo_id, each.error, each.data[cut:]) for each in statuses]
        ages_s = self._present.take_state(states, now_s)
        return Readings(
            time_s=now_s,
            positions_deg=self._mounting.joint_deg(cache.pulses),
            goals_deg=self._mounting.joint_deg(goals),
            torque=cache.torque.states,
            errors=cache.errors,
            age_s=ages_s,
        )

    def feedback(self) -> Feedback:
        """Read position and load of every servo; return the last values, with age, of silent ones.

        Called in every tick. A servo that did not answer gets no goals until `look_after` has read
        that it has not restarted. Raises PortError.
        """
        line, cache = self._line or self.line, self._cache
        found = self._state.ask(line)
        now_s = line.transport.clock.now()
        ages_s = self._present.take_state(found, now_s)
        if any_set(ages_s):
            self._torque.doubt(ages_s)
        return Feedback(
            time_s=now_s,
            positions_deg=self._mounting.joint_deg(cache.pulses),
            effort=cache.effort,
            errors=cache.errors,
            age_s=ages_s,
        )

    def look_after(self) -> Health:
        """Read torque and limits of one servo, in turns; return the last readings of all servos.

        Called in every tick. Servos that answer again after a silence come first, since they get
        no goals until this read; it switches those off that have restarted.
        """
        line, cache, doubted = self._line or self.line, self._cache, self._torque.doubted
        back: Sequence[int] = ()  # ids to read: of servos back from a silence, else one in turn
        if any_set(doubted):
            heard = cache.heard_s == cache.heard_s.max()
            back = [self._ids[n] for n in np.flatnonzero(doubted & heard).tolist()]
        if not back:
            back = (self._ids[self._turn],)
            self._turn = (self._turn + 1) % len(self._ids)
        size, found = self._dialect.control_size, []
        if self._dialect.sync_read and len(back) > 1:
            found = _statuses(line.sync_read(SpanRead(back, CONTROL, size)))
        else:
            found = [
                status for each in back[:_AT_ONCE] if (status := line.read(each, CONTROL, size))
            ]
        for status in found:
            index = self._index[status.servo_id]
            cache.heard_s[index] = line.transport.clock.now()
            self._torque.look_after(line, index, status.data)
            # A servo that answers again is included again in the reads that left it out.
            for group in self._groups:
                if group.leaves_out:
                    group.trust(status.servo_id)
        return cache.health(line.transport.clock.now(), self._present.current_ma)

    def enable_torque(self, index: int) -> str:
        """Switch one servo's torque on without motion; return why it stays off, "" if confirmed."""
        obstacle = super().enable_torque(index)
        self._begin_where_it_stands(index)
        return obstacle

    def keep_torque(self, index: int) -> bool:
        """Hold a servo whose torque is on at its present position; return whether it confirmed."""
        is_kept = super().keep_torque(index)
        self._begin_where_it_stands(index)
        return is_kept

    def _begin_where_it_stands(self, index: int) -> None:
        """Store the present position of a servo whose torque came on as its last goal."""
        self._behind[index] = False
        self._sent = self._sent.copy()
        self._sent[index] = self._cache.pulses[index]

    def reboot(self, index: int) -> None:
        """Switch one servo's torque off, which clears its errors, in place of a restart.

        Not all models have an instruction to restart.
        """
        self._torque.disable(self.line, index)
        self._present.forget_trouble(index)

    def _identities(self, line: Line) -> Sequence[Any]:
        return identify_all(line, self._servos, strict=self._strict)

    def _first_remarks(self) -> Iterable[str]:
        return [
            f"{named(self._servos[n].joint)} holds already: its torque was on before the start"
            for n in np.flatnonzero(self.read().torque == Torque.ON).tolist()
        ]

    def _all_off(self) -> bytes:
        return codec.torque(self._ids, on=False)

    def _ask_torque(self, line: Line) -> Iterable[Status]:
        return _statuses(self._holding.ask(line))


def _statuses(found: Answers) -> list[Status]:
    return statuses_in(found) if isinstance(found, bytes) else found
