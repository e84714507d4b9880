"""A face whose servos are held with torque on and moved from pose to pose through the bridge.

All goals pass the safety gate. One thread uses the bus; code that waits for a person or a tracker
does so in `hold_while` or `work`, so that the servos receive goals all the time.
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

from firmware_bridge.bus import Feedback, ServoBus
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
#: Calls a function in the thread that speaks to the servos.
Here = Callable[[Callable[[], Any]], Any]

#: Slow enough to watch and to stop; no joint is in a hurry here.
SPEED_DEG_S = 30.0
#: A joint stands when its encoder changes by less than this in that time: two steps of it.
_STILL_DEG, _STILL_S = 0.18, 0.2
#: Longer than any servo needs that is not held up.
_SETTLE_S = 1.5
#: A servo without an encoder overshoots and rings so long, once it had the time for its way.
_RINGS_S = 0.3
#: Longer than any hobby servo needs, after its first pulse, to catch up with its goal.
_CATCHES_UP_S, _CAUGHT_UP_DEG = 5.0, 0.1
#: A job that waits for the servos looks so often whether they are held at all.
_LOOK_S = 0.2
#: Chirps to 12 Hz need four samples a period.
_DRIVE_RATE_HZ = 50.0
#: So much longer than a start takes a servo may need to show that it holds.
_HOLDS_S = 2.0
#: A servo's goals and places are asked for twice in a tick while it is driven.
_TWICE = 1.6


def held_rate_hz(settings: FaceSettings) -> float:
    """Return the tick rate of a held face: the higher of its own and 50 Hz, which chirps need.

    Its own where a bus is too slow.
    """
    if settings.rate_hz >= _DRIVE_RATE_HZ:
        return settings.rate_hz
    rate_hz = _TWICE * _DRIVE_RATE_HZ
    slow = [one.bus_kind.slowness(one.wiring, rate_hz) for one in settings.alone.values()]
    return settings.rate_hz if any(slow) else _DRIVE_RATE_HZ


class HeldFace:
    """Servos with torque on from `__enter__` to `__exit__`, on a bus and a life cycle of their own.

    Poses are joint degrees (n_joints,) of the joints in `joints`, by default the mouth's in the
    order of the YAML; all others stay at their goals of the beginning. Methods raise what `Bridge`
    and the bus raise, and FaceStopped when a person stops the face; it is limp then. Entered means
    that every servo is known to hold: hobby servos, too, have had their first pulse.
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
        self._opened: DrivenFace | None = None
        self._speed_deg_s = speed_deg_s
        names = list(settings.servos)
        self._posed = [names.index(name) for name in joints or settings.mouth_servos]
        can = settings.capabilities if bus is None else bus.capabilities
        places = [can.of(index).place for index in range(len(names))]
        self._has_place = np.array(places, dtype=np.bool_)
        speeds_deg_s = [servo.max_speed_deg_s for servo in settings.servos.values()]
        self._blind_speed_deg_s = np.where(self._has_place, np.inf, speeds_deg_s)
        self._blind_until_s = 0.0
        self._goal_deg = self._passed_deg = np.zeros(len(names))
        self._from_neutral = from_neutral
        self._end = end
        self._ticks: Iterator[tuple[float, int]] = iter(())
        self._leaving = ExitStack()

    @property
    def life(self) -> LifeCycle:
        """The life cycle, with the stop report at its end. Raises RuntimeError before entry."""
        return self._driven.life

    @property
    def _driven(self) -> DrivenFace:
        if self._opened is None:
            raise RuntimeError("the face is used outside its `with` block")
        return self._opened

    @property
    def torque_on(self) -> list[bool | None]:
        """Whether each servo of the face holds; None: unknown."""
        return self._driven.bus.torque.as_json()

    @property
    def has_place(self) -> NDArray[np.bool_]:
        """Whether the servo of each posed joint reports its position.

        Returns
        -------
        NDArray[np.bool_]
            (n_joints,).
        """
        return np.asarray(self._has_place[self._posed])

    @property
    def stands_deg(self) -> Array:
        """The positions of the posed joints. Raises PortGone.

        Measured; the goal sent last of a servo that reports none (`has_place`).

        Returns
        -------
        Array
            (n_joints,) degrees.
        """
        return self._stands_deg()[self._posed]

    @property
    def goal_deg(self) -> Array:
        """The goal positions of the posed joints; known even of servos that report no position.

        Returns
        -------
        Array
            (n_joints,) degrees.
        """
        return self._goal_deg[self._posed]

    @property
    def sent_deg(self) -> Array:
        """The goals that the posed joints were sent last, short of `goal_deg` while one catches up.

        Returns
        -------
        Array
            (n_joints,) degrees.
        """
        return self._sent_deg(self._feedback())[self._posed]

    @property
    def effort(self) -> Array:
        """The measured effort of the posed joints. Raises PortGone.

        Returns
        -------
        Array
            (n_joints,), as shares of the stall torque.
        """
        return self._feedback().effort[self._posed]

    def move(self, goal_deg: Array) -> Array:
        """Move the posed joints to a goal at limited speed; wait until still, 1.5 s at most.

        A servo without an encoder gets the time that its `max_speed_deg_s` needs for the whole way.

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
        whole_deg[self._posed] = goal_deg
        self._move_all(whole_deg)
        return self.stands_deg

    def hold(self, seconds: float) -> None:
        """Hold the pose for some seconds."""
        until_s = self._clock.now() + seconds
        while self._clock.now() < until_s:
            self._tick()

    def hold_while(self, ask: Callable[[], Answer]) -> Answer:
        """Hold the pose while `ask` runs in a thread; return its result or raise its error."""
        answers: list[Answer] = []
        errors: list[BaseException] = []

        def run() -> None:
            try:
                answers.append(ask())
            except BaseException as error:
                errors.append(error)

        waiting = threading.Thread(target=run, daemon=True)
        waiting.start()
        while waiting.is_alive():
            self._tick()
        if errors:
            raise errors[0]
        return answers[0]

    def work(self, job: Callable[[Here], Answer]) -> Answer:
        """Hold the pose while `job` runs in a thread; return its result or raise its error.

        job: receives a function that runs another one in the thread of the servos, between two
        ticks, and returns its result: for all access to the servos. Slow work in the job delays no
        tick and no stop.
        """
        calls: queue.SimpleQueue[tuple[Callable[[], Any], Future[Any]]] = queue.SimpleQueue()
        is_over = threading.Event()

        def here(call: Callable[[], Any]) -> Any:
            done: Future[Any] = Future()
            calls.put((call, done))
            while not is_over.is_set():
                if wait([done], _LOOK_S).done:
                    return done.result()
            raise RuntimeError("the face is held no more")

        def next_call() -> None:
            """Run the calls that the job has queued; return their results and errors to the job.

            Called between two ticks. FaceStopped is raised here as well.
            """
            while True:
                try:
                    call, done = calls.get_nowait()
                except queue.Empty:
                    return
                try:
                    done.set_result(call())
                except Exception as error:  # of the job's own doing: raised there
                    done.set_exception(error)
                    if isinstance(error, FaceStopped):
                        raise

        answers: list[Answer] = []
        errors: list[BaseException] = []

        def run() -> None:
            try:
                answers.append(job(here))
            except BaseException as error:
                errors.append(error)

        working = threading.Thread(target=run, daemon=True)
        working.start()
        try:
            while working.is_alive():
                next_call()
                self._tick()
        finally:
            is_over.set()
        if errors:
            raise errors[0]
        return answers[0]

    def drive(self, goals_deg: Array, rate_hz: float) -> Array:
        """Send goals, one a tick, through the gate, and return the positions measured after each.

        An encoder is read half a tick after its goal was sent: a goal that is held for a tick is on
        average half a tick old. Positions of ticks that the computer missed are interpolated.

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
        """
        if rate_hz != self.rate_hz:
            raise ValueError(f"this face is driven at {self.rate_hz:g} Hz, not {rate_hz:g}")
        self.move(goals_deg[0])
        seen_deg = np.full(goals_deg.shape, np.nan)
        self._next_tick()  # those that passed until now are of no concern
        row = -1
        while True:
            time_s, late = self._next_tick()
            row += 1 + late
            if row >= len(goals_deg):
                break
            whole_deg = self._goal_deg.copy()
            whole_deg[self._posed] = goals_deg[row]
            self._goal_deg = whole_deg
            self._send(time_s, late)
            self._clock.sleep_until(time_s + 0.5 / rate_hz)
            seen_deg[row] = self._stands_deg()[self._posed]
        return _filled(seen_deg)

    def __enter__(self) -> Self:
        """Switch torque on, and return when all servos hold, in neutral if `from_neutral`.

        Raises FaceStopped if a person stops the face meanwhile, ServoError if a servo stays limp.
        """
        try:
            self._arm()
        except BusError as error:
            self._tell_stopped(error)
            raise
        if self.life.report is not None:  # let go by a second signal
            raise FaceStopped(self.life.report, self.life.signal_number)
        return self

    def _arm(self) -> None:
        """Open the bus and its bridge, switch torque on, and move to neutral if `from_neutral`.

        After an error all is closed again. With `config`, a live board is made for pages that
        watch.
        """
        with ExitStack() as leaving:
            control = ControlOptions()
            if self._config is not None:
                watched = SilentBoard.create(self._settings, self._config)
                self._board = leaving.enter_context(watched)
                about = {"config": self._config}
                control = ControlOptions(about=about, watched_fd=self._board.fileno)
            how = DriveOptions(rate_hz=self.rate_hz, control=control)
            opening = driven_face(self._settings, self._clock, self._channel, how, self._bus)
            self._opened = leaving.enter_context(opening)
            self._ticks = self.life.ticks()
            self.life.start()
            bus = self._opened.bus
            self._goal_deg = self._passed_deg = bus.read().start_deg(bus.capabilities)
            self._await_torque()
            if self._from_neutral:
                self._move_all(np.zeros_like(self._goal_deg))
                self._settle()
            self._leaving = leaving.pop_all()

    def _await_torque(self) -> None:
        """Tick until every servo is known to hold. Raises ServoError for those that stay limp."""
        bus, joints = self._driven.bus, self._settings.joints()
        until_s = self._clock.now() + bus.capabilities.start_s(len(joints)) + _HOLDS_S
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
        self._leaving.__exit__(kind, error, trace)
        self._tell_stopped(error)

    def _tell_stopped(self, error: BaseException | None) -> None:
        """Raise FaceStopped if `error`, which ended the block, comes from a person's stop.

        It is an ImmediateStop then, or a BusError after the stop.
        """
        if self._opened is None or self.life.report is None:
            return
        life, report = self.life, self.life.report
        overtaken = life.stopped_by_person and isinstance(error, BusError)
        if isinstance(error, ImmediateStop) or overtaken:
            raise FaceStopped(report, life.signal_number) from error

    def _move_all(self, whole_deg: Array) -> None:
        """Move all joints to `whole_deg` (n_servos,) along a ramp, and tick until it is over.

        Stores until when servos without encoders, which may be slower than the ramp, can still
        move.
        """
        start_s = self._clock.now()
        way_s = float((np.abs(whole_deg - self._goal_deg) / self._blind_speed_deg_s).max())
        ramp = Ramp.at_speed(self._goal_deg, whole_deg, start_s, self._speed_deg_s)
        over = False
        while not over:
            now_s = self._clock.now()
            over = ramp.is_over(now_s)
            self._goal_deg = ramp.at(now_s)
            self._tick()
        self._blind_until_s = self._clock.now() + way_s + _RINGS_S

    def _settle(self) -> Array:
        """Tick until all encoders are still, at most 1.5 s; return the posed joints' angles.

        Servos without encoders get the time that their speed needs.
        """
        if not self._has_place.all():
            self._await_sent()
            self.hold(self._blind_until_s - self._clock.now())
        if not self._has_place.any():
            return self.stands_deg
        until_s = self._clock.now() + _SETTLE_S
        before_deg = self._heard_deg()
        while self._clock.now() < until_s:
            # By ticks: of a computer that stands still for so long no servo hears anything.
            for _ in range(math.ceil(_STILL_S * self.rate_hz)):
                self._tick()
            now_deg = self._heard_deg()
            if np.abs(now_deg - before_deg).max() < _STILL_DEG:
                break
            before_deg = now_deg
        return self.stands_deg

    def _await_sent(self) -> None:
        """Tick until servos that started without a known position were sent their goals."""
        latest_s = self._clock.now() + _CATCHES_UP_S
        while (sent_deg := self._feedback().sent_deg) is not None and self._clock.now() < latest_s:
            if np.nanmax(np.abs(sent_deg - self._goal_deg), initial=0.0) < _CAUGHT_UP_DEG:
                break
            self._tick()
            self._blind_until_s = self._clock.now() + _RINGS_S

    def _heard_deg(self) -> Array:
        """Return the measured positions, in degrees, of the servos that can report one.

        NaN for a servo without a reading from this tick.
        """
        feedback = self._feedback()
        return np.where(feedback.age_s == 0.0, feedback.positions_deg, np.nan)[self._has_place]

    def _stands_deg(self) -> Array:
        feedback = self._feedback()
        sent_deg = self._sent_deg(feedback)
        return np.asarray(np.where(self._has_place, feedback.positions_deg, sent_deg))

    def _sent_deg(self, feedback: Feedback) -> Array:
        if feedback.sent_deg is None:
            return self._passed_deg
        sent_deg = feedback.sent_deg
        return np.asarray(np.where(np.isnan(sent_deg), self._passed_deg, sent_deg))

    def _feedback(self) -> Feedback:
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
        self._passed_deg = report.sent_deg
        if self._board is not None:
            self._board.tell(self._driven.bridge, report)


def _filled(columns: Array) -> Array:
    """Return `columns` (n, k) with rows that contain NaN interpolated between complete rows.

    Linear in the row number; before the first and after the last complete row, that row is
    repeated.
    """
    rows = np.arange(len(columns))
    seen = np.isfinite(columns).all(axis=1)
    return np.stack([np.interp(rows, rows[seen], column[seen]) for column in columns.T], axis=1)
