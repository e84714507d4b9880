"""A face whose servos are held with torque on and moved from pose to pose through the bridge.

All goals pass the safety gate. One thread uses the bus; code that waits for a person or a tracker
runs in `hold_while` or `work`, so that the servos receive goals meanwhile.
"""

import math
import queue
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, wait
from contextlib import ExitStack
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from calibration.mouth_servos import STALL_DEG
from firmware_bridge.bus import Feedback, ServoBus, ServoState
from firmware_bridge.clock import Clock
from firmware_bridge.errors import BusError, PortError, PortGone, ServoError
from firmware_bridge.gate.ramp import Ramp
from firmware_bridge.joints import named
from firmware_bridge.known_torque import Torque
from firmware_bridge.loop.life_cycle import ImmediateStop, LifeCycle
from firmware_bridge.loop.targets import MemoryTargetChannel, ServoTargets
from firmware_bridge.stopping import StopLevel
from lipservo.runtime.servos.driven_face import (
    ControlOptions,
    DrivenFace,
    DriveOptions,
    driven_face,
)
from lipservo.runtime.servos.face_stopped import FaceStopped
from lipservo.runtime.status.silent_board import SilentBoard
from lipservo.settings.settings import FaceSettings
from lipsync.arrays import Array

Answer = TypeVar("Answer")
#: A function that runs another one in the thread that uses the bus, and returns its result.
Here = Callable[[Callable[[], Any]], Any]

#: Slow enough to watch and to stop.
SPEED_DEG_S = 30.0
#: A joint is still when its encoder changes by less than two of its steps in this time.
_STILL_DEG, _STILL_S = 0.18, 0.2
#: A joint gets its whole goal where it gets all but this.
_SHORT_DEG = 1.0
#: Longer than any servo needs that is not held up.
_SETTLE_S = 1.5
#: After the time that the way takes, a servo without an encoder may still ring for so long.
_RINGING_S = 0.3
#: Longer than any hobby servo needs, after its first pulse, to catch up with its goal.
_CATCHES_UP_S, _CAUGHT_UP_DEG = 5.0, 0.1
#: A job that waits for a call on the bus checks so often whether the face is still held.
_CHECK_EVERY_S = 0.2
#: Chirps to 12 Hz need four samples a period.
_DRIVE_RATE_HZ = 50.0
#: After the time that a start takes, servos get so much longer to confirm torque on.
_TORQUE_MARGIN_S = 2.0
#: Bus traffic of a tick in `drive`, in which positions are read twice, to that of a usual tick.
_TRAFFIC_FACTOR = 1.6


def held_rate_hz(settings: FaceSettings) -> float:
    """Return the tick rate of a held face: its own, or 50 Hz if that is higher.

    Measuring a servo's response by chirps needs 50 Hz. A face with a bus too slow for that keeps
    its own rate.
    """
    if settings.rate_hz >= _DRIVE_RATE_HZ:
        return settings.rate_hz
    busy_hz = _TRAFFIC_FACTOR * _DRIVE_RATE_HZ
    slow = [one.bus_kind.slowness(one.wiring, busy_hz) for one in settings.alone.values()]
    return settings.rate_hz if any(slow) else _DRIVE_RATE_HZ


class HeldFace:
    """Servos with torque on from `__enter__` to `__exit__`, on a bus and a life cycle of their own.

    Poses are joint degrees (n_joints,) of the posed joints: those named in `joints`, by default the
    mouth's in the order of the YAML. All others stay at their first goals. Methods raise what
    `Bridge` and the bus raise, and FaceStopped when a person stops the face, which is limp then.
    Once entered, every servo is known to hold; hobby servos have had their first pulse.
    """

    def __init__(
        self,
        settings: FaceSettings,
        clock: Clock,
        *,
        bus: ServoBus | None = None,
        speed_deg_s: float = SPEED_DEG_S,
        joints: Sequence[str] | None = None,
        from_neutral: bool = True,
        end: StopLevel = StopLevel.SOFT,
        config: str | None = None,
    ) -> None:
        """Create the face; no port is opened. bus: not yet entered; None: the face's own.

        speed_deg_s: of all moves between poses. joints: names of the joints in poses; None: the
        mouth's. from_neutral: move all joints to neutral on entry. end: kind of stop when the block
        ends without an error. config: the face's name or path in the status, for pages that watch
        it; None: no live board is made.
        """
        self._settings, self._config = settings, config
        self.rate_hz = held_rate_hz(settings)
        self._clock = clock
        self._channel = MemoryTargetChannel()
        self._bus = bus
        self._board: SilentBoard | None = None
        self._driven_face: DrivenFace | None = None
        self._speed_deg_s = speed_deg_s
        names = list(settings.servos)
        self._posed_indices = [names.index(name) for name in joints or settings.mouth_servos]
        capabilities = settings.capabilities if bus is None else bus.capabilities
        has_place = [capabilities.of(index).place for index in range(len(names))]
        self._has_place = np.array(has_place, dtype=np.bool_)
        speeds_deg_s = [servo.max_speed_deg_s for servo in settings.servos.values()]
        # Servos that report no position ("blind") get time by their top speed; others are measured.
        self._blind_speed_deg_s = np.where(self._has_place, np.inf, speeds_deg_s)
        self._blind_until_s = 0.0
        # Of all joints: present goals, and those that the safety gate let pass to the servos last.
        self._goal_deg = self._last_sent_deg = np.zeros(len(names))
        self._from_neutral = from_neutral
        self._end = end
        self._ticks: Iterator[tuple[float, int]] = iter(())
        self._exit_stack = ExitStack()

    @property
    def life(self) -> LifeCycle:
        """The life cycle, with the stop report at its end. Raises RuntimeError before entry."""
        return self._driven.life

    @property
    def _driven(self) -> DrivenFace:
        if self._driven_face is None:
            raise RuntimeError("the face is used outside its `with` block")
        return self._driven_face

    @property
    def torque_on(self) -> list[bool | None]:
        """Whether each servo of the face holds; None: unknown."""
        return self._driven.bus.torque.as_json()

    @property
    def has_place(self) -> NDArray[np.bool_]:
        """Whether the servo of each posed joint (the constructor's `joints`) reports its position.

        Returns
        -------
        NDArray[np.bool_]
            (n_joints,).
        """
        return np.asarray(self._has_place[self._posed_indices])

    @property
    def stands_deg(self) -> Array:
        """The measured positions of the posed joints. Raises PortGone.

        For a servo that reports no position (`has_place` is False), the goal sent last.

        Returns
        -------
        Array
            (n_joints,) degrees.
        """
        return self._position_deg()[self._posed_indices]

    @property
    def goal_deg(self) -> Array:
        """The goals of the posed joints (the constructor's `joints`), with or without an encoder.

        Returns
        -------
        Array
            (n_joints,) degrees.
        """
        return self._goal_deg[self._posed_indices]

    @property
    def sent_deg(self) -> Array:
        """The goals sent last to the posed joints; short of `goal_deg` while one is eased up to it.

        Returns
        -------
        Array
            (n_joints,) degrees.
        """
        return self._sent_deg(self._feedback())[self._posed_indices]

    def check_sent_whole(self) -> None:
        """Raise ServoError where a posed joint was not sent its whole goal: hot, limp or too slow.

        Not for a limp joint that answers from far off its goal: it was let go as jammed, and the
        capture leaves out what it has not reached.
        """
        feedback, states = self._feedback(), np.array(self._driven.bridge.servo_states)
        sent_deg = self._sent_deg(feedback)
        short_deg = np.abs(sent_deg - self._goal_deg)
        answers_limp = (states != ServoState.DRIVEN) & (feedback.age_s == 0.0)
        short_deg[answers_limp & (short_deg > STALL_DEG)] = 0.0
        worst = max(self._posed_indices, key=short_deg.item)
        if short_deg[worst] > _SHORT_DEG:
            name, goal_deg = list(self._settings.servos)[worst], self._goal_deg[worst]
            raise ServoError(
                f"{name} was sent {sent_deg[worst]:.1f} of {goal_deg:.1f} deg: too hot, without "
                "power or too slow; let it cool or check its cable, then run the same command again"
            )

    @property
    def effort(self) -> Array:
        """The measured effort of the posed joints. Raises PortGone.

        Returns
        -------
        Array
            (n_joints,), as shares of the stall torque.
        """
        return self._feedback().effort[self._posed_indices]

    def move(self, goal_deg: Array) -> Array:
        """Move the posed joints to a goal at limited speed; wait until still, 1.5 s at most.

        Servos without an encoder get the time that their `max_speed_deg_s` needs for the whole way.

        Parameters
        ----------
        goal_deg : Array
            (n_joints,) degrees.

        Returns
        -------
        Array
            (n_joints,) degrees: the positions reached, as in `stands_deg`.
        """
        self.lead(goal_deg)
        return self._settle()

    def lead(self, goal_deg: Array) -> Array:
        """Ramp the goals of the posed joints to `goal_deg`; do not wait until the servos are still.

        Parameters
        ----------
        goal_deg : Array
            (n_joints,) degrees.

        Returns
        -------
        Array
            (n_joints,) degrees: the positions when the last goal has been sent.
        """
        whole_deg = self._goal_deg.copy()
        whole_deg[self._posed_indices] = goal_deg
        self._move_all(whole_deg)
        return self.stands_deg

    def hold(self, seconds: float) -> None:
        """Hold the pose for some seconds."""
        until_s = self._clock.now() + seconds
        while self._clock.now() < until_s:
            self._tick()

    def hold_while(self, ask: Callable[[], Answer]) -> Answer:
        """Hold the pose while `ask` runs in a thread; return its result or raise its error."""
        return self.work(lambda _: ask())

    def work(self, job: Callable[[Here], Answer]) -> Answer:
        """Hold the pose while `job` runs in a thread; return its result or raise its error.

        job: gets a function, by which alone it may access the servos: this runs another function in
        the servos' thread, between two ticks, and returns its result. Slow work in the job itself
        delays no tick and no stop.
        """
        queued_calls: queue.SimpleQueue[tuple[Callable[[], Any], Future[Any]]] = queue.SimpleQueue()
        is_over = threading.Event()

        def in_servo_thread(call: Callable[[], Any]) -> Any:
            """Queue a call for the servos' thread, wait until it was run, return its result.

            Raises the call's error; RuntimeError once the face is held no more.
            """
            result: Future[Any] = Future()
            queued_calls.put((call, result))
            while not is_over.is_set():
                if wait([result], _CHECK_EVERY_S).done:
                    return result.result()
            raise RuntimeError("the face is held no more")

        def run_queued_calls() -> None:
            """Run the calls that the job has queued; pass their results and errors to the job.

            Called between two ticks. FaceStopped is also raised here, which ends `work`.
            """
            while not queued_calls.empty():
                call, result = queued_calls.get()
                try:
                    result.set_result(call())
                except Exception as error:  # raised in the job, which made the call
                    result.set_exception(error)
                    if isinstance(error, FaceStopped):
                        raise

        answer: Future[Answer] = Future()

        def run_job() -> None:
            try:
                answer.set_result(job(in_servo_thread))
            except BaseException as error:
                answer.set_exception(error)

        thread = threading.Thread(target=run_job, daemon=True)
        thread.start()
        try:
            while thread.is_alive():
                run_queued_calls()
                self._tick()
        finally:
            is_over.set()
        return answer.result()

    def drive(self, goals_deg: Array, rate_hz: float) -> Array:
        """Send goals, one a tick, through the gate, and return the positions measured after each.

        The joints are moved to the first goal beforehand. Encoders are read half a tick after a
        goal was sent: goals that are held for a tick are on average half a tick old. Positions of
        ticks that the computer missed are interpolated.

        Parameters
        ----------
        goals_deg : Array
            (n, n_joints) degrees, of the posed joints.
        rate_hz : float
            Goals a second; must be this face's `rate_hz`.

        Returns
        -------
        Array
            (n, n_joints) degrees: encoder positions half a tick after each goal.

        Raises
        ------
        ValueError
            If `rate_hz` is another rate than this face's.
        ServoError
            As from `check_sent_whole`.
        """
        if rate_hz != self.rate_hz:
            raise ValueError(f"this face is driven at {self.rate_hz:g} Hz, not {rate_hz:g}")
        self.move(goals_deg[0])
        self.check_sent_whole()
        measured_deg = np.full(goals_deg.shape, np.nan)
        self._next_tick()  # ticks missed until now are not counted below
        row = -1
        while True:
            time_s, late = self._next_tick()
            # The goals of missed ticks are skipped; their rows stay NaN.
            row += 1 + late
            if row >= len(goals_deg):
                break
            whole_deg = self._goal_deg.copy()
            whole_deg[self._posed_indices] = goals_deg[row]
            self._goal_deg = whole_deg
            self._send(time_s, late)
            self._clock.sleep_until(time_s + 0.5 / rate_hz)
            measured_deg[row] = self._position_deg()[self._posed_indices]
        return _with_gaps_interpolated(measured_deg)

    def __enter__(self) -> Self:
        """Switch torque on, and return when all servos hold, in neutral if `from_neutral`.

        Raises FaceStopped if a person stops the face meanwhile, ServoError if a servo stays limp.
        """
        try:
            self._arm()
        except BusError as error:
            self._raise_if_stopped(error)
            raise
        if self.life.report is not None:  # let go by a second signal
            raise FaceStopped(self.life.report, self.life.signal_number)
        return self

    def _arm(self) -> None:
        """Open the bus and its bridge, switch torque on, and move to neutral if `from_neutral`.

        After an error all is closed again. With `config`, a live board (shared memory) is made,
        from which the dashboard's page shows the face.
        """
        with ExitStack() as exit_stack:
            control = ControlOptions()
            if self._config is not None:
                watched = SilentBoard.create(self._settings, self._config)
                self._board = exit_stack.enter_context(watched)
                about = {"config": self._config}
                control = ControlOptions(about=about, watched_fd=self._board.fileno)
            options = DriveOptions(rate_hz=self.rate_hz, control=control)
            opening = driven_face(self._settings, self._clock, self._channel, options, self._bus)
            self._driven_face = exit_stack.enter_context(opening)
            self._ticks = self.life.ticks()
            self.life.start()
            bus = self._driven_face.bus
            self._goal_deg = self._last_sent_deg = bus.read().start_deg(bus.capabilities)
            self._await_torque()
            if self._from_neutral:
                self._move_all(np.zeros_like(self._goal_deg))
                self._settle()
            # All has been opened: it stays open until `__exit__`.
            self._exit_stack = exit_stack.pop_all()

    def _await_torque(self) -> None:
        """Tick until every servo is known to hold. Raises ServoError for those that stay limp."""
        bus, joints = self._driven.bus, self._settings.joints()
        until_s = self._clock.now() + bus.capabilities.start_s(len(joints)) + _TORQUE_MARGIN_S
        while (limp := np.flatnonzero(bus.torque.states != Torque.ON)).size:
            if self._clock.now() > until_s:
                lines = [f"{named(joints[index])} is not known to hold" for index in limp]
                raise ServoError("\n".join([*lines, *self._driven.bridge.troubles]))
            self._tick()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: Any
    ) -> None:
        if kind is None and not self.life.stopping:
            self.life.stop(self._end)
        self._exit_stack.__exit__(kind, error, trace)
        self._raise_if_stopped(error)

    def _raise_if_stopped(self, error: BaseException | None) -> None:
        """Raise FaceStopped if `error`, which ended the block, comes from a person's stop.

        It is an ImmediateStop then, or a BusError after the stop.
        """
        if self._driven_face is None or self.life.report is None:
            return
        life, report = self.life, self.life.report
        overtaken = life.stopped_by_person and isinstance(error, BusError)
        if isinstance(error, ImmediateStop) or overtaken:
            raise FaceStopped(report, life.signal_number) from error

    def _move_all(self, whole_deg: Array) -> None:
        """Move the goals of all joints to `whole_deg` (n_servos,) along a ramp, tick by tick.

        Stores the time until which servos without encoders, which may be slower than the ramp, can
        still move.
        """
        start_s = self._clock.now()
        slowest_s = float((np.abs(whole_deg - self._goal_deg) / self._blind_speed_deg_s).max())
        ramp = Ramp.at_speed(self._goal_deg, whole_deg, start_s, self._speed_deg_s)
        is_over = False
        while not is_over:
            now_s = self._clock.now()
            is_over = ramp.is_over(now_s)
            self._goal_deg = ramp.at(now_s)
            self._tick()
        self._blind_until_s = self._clock.now() + slowest_s + _RINGING_S

    def _settle(self) -> Array:
        """Tick until all encoders are still, at most 1.5 s; return the posed joints' angles.

        Servos without encoders get the time that their speed needs.
        """
        if not self._has_place.all():
            self._await_goals_sent()
            self.hold(self._blind_until_s - self._clock.now())
        if not self._has_place.any():
            return self.stands_deg
        until_s = self._clock.now() + _SETTLE_S
        before_deg = self._measured_deg()
        while self._clock.now() < until_s:
            # Counted in ticks, not by the clock: while the computer stalls, servos get no goals.
            for _ in range(math.ceil(_STILL_S * self.rate_hz)):
                self._tick()
            now_deg = self._measured_deg()
            if np.abs(now_deg - before_deg).max() < _STILL_DEG:
                break
            before_deg = now_deg
        return self.stands_deg

    def _await_goals_sent(self) -> None:
        """Tick, 5 s at most, until the bus has sent all servos their goals.

        A bus of servos without encoders eases goals in after the start, and reports those sent
        last; other buses report none, and nothing is waited for.
        """
        latest_s = self._clock.now() + _CATCHES_UP_S
        while (sent_deg := self._feedback().sent_deg) is not None and self._clock.now() < latest_s:
            if np.nanmax(np.abs(sent_deg - self._goal_deg), initial=0.0) < _CAUGHT_UP_DEG:
                break
            self._tick()
            self._blind_until_s = self._clock.now() + _RINGING_S

    def _measured_deg(self) -> Array:
        """Return the measured positions, in degrees, of the servos that can report one.

        NaN for a servo without a reading from this tick.
        """
        feedback = self._feedback()
        return np.where(feedback.age_s == 0.0, feedback.positions_deg, np.nan)[self._has_place]

    def _position_deg(self) -> Array:
        """Return the angles (n_servos,) measured; the goal sent last where none is measured."""
        feedback = self._feedback()
        sent_deg = self._sent_deg(feedback)
        return np.asarray(np.where(self._has_place, feedback.positions_deg, sent_deg))

    def _sent_deg(self, feedback: Feedback) -> Array:
        """Return the goals (n_servos,) sent last: as the bus reports, else as the gate passed."""
        if feedback.sent_deg is None:
            return self._last_sent_deg
        sent_deg = feedback.sent_deg
        return np.asarray(np.where(np.isnan(sent_deg), self._last_sent_deg, sent_deg))

    def _feedback(self) -> Feedback:
        """Return the servos' last readings. Raises PortGone, with a remedy, without the port."""
        try:
            return self._driven.bus.feedback()
        except PortError as error:
            raise PortGone(
                "the port of the servos is gone; plug it in and go on with what was kept"
            ) from error

    def _tick(self) -> None:
        self._send(*self._next_tick())

    def _next_tick(self) -> tuple[float, int]:
        """Wait for the next tick; return (its time, ticks missed before it).

        Raises FaceStopped once the face is stopped.
        """
        for time_s, late in self._ticks:
            return time_s, late
        raise FaceStopped(self._driven.bridge.stop_report(), self.life.signal_number)

    def _send(self, time_s: float, late: int) -> None:
        self._channel.publish(ServoTargets(time_s, self._goal_deg))
        report = self._driven.bridge.tick(time_s, late)
        self._last_sent_deg = report.sent_deg
        if self._board is not None:
            self._board.tell(self._driven.bridge, report)


def _with_gaps_interpolated(values: Array) -> Array:
    """Return `values` (n, k) with rows that contain NaN interpolated between complete rows.

    Interpolation is linear in the row number; before the first and after the last complete row,
    that row is repeated.
    """
    rows = np.arange(len(values))
    known = np.isfinite(values).all(axis=1)
    return np.stack([np.interp(rows, rows[known], column[known]) for column in values.T], axis=1)
