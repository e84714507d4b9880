"""Several buses of one face as one, with a thread for each, so that a slow bus delays no other.

A tick hands every bus its newest goals and takes the newest reports of each; it waits for none
longer than a part of its period, and for one that is behind not at all. A thread uses its bus only
when it was handed a job: when the loop stops, the servos receive nothing, and their watchdogs trip
as with one bus.
"""

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import fields
from functools import partial
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.bus import Array, Feedback, Health, Readings, ServoBus, all_set, check_shape
from firmware_bridge.capabilities import mixed_capabilities
from firmware_bridge.clock import Clock
from firmware_bridge.errors import BusError, PortError, PortGone
from firmware_bridge.known_torque import SILENT_S, KnownTorque, Torque

#: Share of a tick that the loop may wait for buses, and the least wait where ticks are short.
_SHARE: Final = 0.5
_LEAST_WAIT_S: Final = 0.005
#: Longest waits of single calls: for torque off on all buses, for positions, for a port to open,
#: for the end. A job that takes longer goes on in its thread. A later `reopen` or `read` takes its
#: result, a later `disable_all` begins anew.
_OFF_S: Final = 0.1
_READ_S: Final = 0.5
_OPEN_S: Final = 0.1
_END_S: Final = 2.0
#: A bus that stands still for so long counts as lost; its thread may hang in the kernel.
_HUNG_S: Final = 5.0
#: A loop that runs checks its buses more often than that; a longer pause is the program's own.
_PAUSE_S: Final = 0.5
_BUSY: Final = "has not confirmed yet: its bus is busy"
#: The key of a job: its name, and the index on the bus of the servo that it concerns, -1: all.
_Key = tuple[str, int]
_ALL: Final = -1
_WRITE: Final = ("write", _ALL)
_READ: Final = ("read", _ALL)
_FEEDBACK: Final = ("feedback", _ALL)
_LOOK: Final = ("look after", _ALL)
_OFF: Final = ("disable all", _ALL)
_WIDEN: Final = ("widen", _ALL)
_FORGIVE: Final = "forgive"  # of one servo
_REOPEN: Final = ("reopen", _ALL)
_LEAVE: Final = ("leave", _ALL)


class BusThread:
    """One bus, used by its own thread alone.

    A job is a call of the bus, with a key: its name, and the index on the bus of the servo that it
    concerns, -1 for all. A job replaces a waiting one with its key. at: the indices of the bus's
    servos in the face. lost: why the bus's port is gone; None: it is not. is_behind: whether the
    bus was waited for in vain, and has not caught up since. feedback, health: the last report, and
    its time; None: none yet. thread: ends after `leave`; one that hangs, with the process.
    """

    def __init__(self, name: str, bus: ServoBus, at: NDArray[np.intp], clock: Clock) -> None:
        """Start the thread of `bus`, an open bus that no other thread uses from now on.

        name: of the bus. at: the indices of its servos in the face.
        """
        self.name, self.bus, self.at, self._clock = name, bus, at, clock
        self.lost: PortError | None = None
        self.is_behind = False
        self.feedback: tuple[Feedback, float] | None = None
        self.health: tuple[Health, float] | None = None
        self._changed = threading.Condition()
        self._jobs: dict[_Key, Callable[[], Any]] = {}
        self._answers: dict[_Key, Any] = {}
        self._running: _Key | None = None
        self._since_s = 0.0
        self._n_offs = 0
        self._error: Exception | None = None
        self.thread = threading.Thread(target=self._run, name=f"bus {name}", daemon=True)
        self.thread.start()

    def hand(self, key: _Key, job: Callable[[], Any]) -> None:
        """Queue a job for the thread; it replaces a job with the same key that has not begun.

        key: (name of the job, index of the servo on the bus, or -1 for all).
        """
        with self._changed:
            self._answers.pop(key, None)
            self._put(key, job)

    def wait(self, key: _Key, wait_s: float) -> bool:
        """Wait up to `wait_s` for the job of `key`; return whether it is done and has an answer.

        key: as for `hand`. False, too, if the job was dropped or the port is gone. Raises errors of
        the bus, except a PortError, which is stored in `lost`.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._is_settled(key), wait_s)
            if self._error is not None:
                error, self._error = self._error, None
                raise error
            return key in self._answers

    def ask(self, key: _Key, job: Callable[[], Any], wait_s: float, *, holds: bool = False) -> Any:
        """Have the thread do a job; return its answer, or None: it is not done within `wait_s`.

        key: (name of the job, index of the servo on the bus, or -1 for all). After None call again
        with the same key: that waits for the job queued or begun before, or fetches its answer.
        holds: whether the servo may hold torque after the job; then a job that has not begun when
        `wait_s` is over is dropped, since later it may be forbidden, and a new call queues it anew.
        Queueing a job discards other answers about its servo that were not fetched. Raises
        PortError when the port is gone.
        """
        with self._changed:
            if key not in self._answers and key != self._running and key not in self._jobs:
                for other in [each for each in self._answers if each[1] == key[1]]:
                    del self._answers[other]
                # A servo that may hold from now on is no longer known to be off.
                if holds and _OFF in self._answers:
                    self._answers[_OFF][key[1]] = False
                self._put(key, job)
        if self.wait(key, wait_s):
            return self.take(key)
        if self.lost is not None:
            raise self.lost
        if holds:
            with self._changed:
                self._jobs.pop(key, None)
        return None

    @property
    def stuck_s(self) -> float:
        """For how many seconds the present job has been running; 0: there is none."""
        with self._changed:
            return 0.0 if self._running is None else self._clock.now() - self._since_s

    def excuse(self, seconds: float) -> None:
        """Subtract `seconds` from the running time of the present job: the program stood still."""
        with self._changed:
            self._since_s += seconds

    def take(self, key: _Key) -> Any:
        """Return and remove the answer to the finished job of `key`; None: there is no answer.

        key: as for `hand`.
        """
        with self._changed:
            return self._answers.pop(key, None)

    def let_go(self) -> None:
        """Drop all waiting jobs, and so make torque off for the whole bus the next job.

        What a person had forgiven is kept, to be done after it: a start begins with torque off.
        The answer of the job that runs now is thrown away: it may have switched torque on before.
        """
        with self._changed:
            forgiven = {key: job for key, job in self._jobs.items() if key[0] == _FORGIVE}
            self._jobs.clear()
            self._answers.clear()
            self._n_offs += 1
            self._put(_OFF, self.bus.disable_all)
            self._jobs |= forgiven

    def was_let_go(self, index: int) -> bool:
        """Return whether the last torque off for the whole bus included its servo `index`."""
        with self._changed:
            let_go = self._answers.get(_OFF)
            return let_go is not None and bool(let_go[index])

    def hear(self) -> None:
        """Read the bus's feedback and store it with its time; a job of the thread."""
        self.feedback = self.bus.feedback(), self._clock.now()

    def look(self) -> None:
        """Read the bus's health report and store it with its time; a job of the thread."""
        self.health = self.bus.look_after(), self._clock.now()

    def lose(self, error: PortError) -> None:
        """Mark the port as gone because of `error`, and drop all jobs and answers."""
        with self._changed:
            self.lost = PortGone(f"bus {self.name}: {error}")
            self._jobs.clear()
            self._answers.clear()
            self._changed.notify_all()

    def leave(self) -> None:
        """Queue the last job: torque off and close the port, even if the port counts as gone."""
        with self._changed:
            self.lost = None
            self._jobs.clear()
            self._put(_LEAVE, partial(self.bus.__exit__, None, None, None))

    def _put(self, key: _Key, job: Callable[[], Any]) -> None:
        if self.lost is None or key == _REOPEN:
            self._jobs[key] = job
            self._changed.notify_all()

    def _is_settled(self, key: _Key) -> bool:
        is_due = key == self._running or key in self._jobs
        return key in self._answers or not is_due or self._error is not None

    def _next(self) -> tuple[_Key, Callable[[], Any], int]:
        """Wait for a job, the oldest; return its key, the job, and how often `let_go` was called.

        By that count `_run` notices a `let_go` while the job ran.
        """
        with self._changed:
            if not self._jobs:
                self.is_behind = False
                self._changed.wait_for(lambda: self._jobs)
            key = next(iter(self._jobs))
            self._running, self._since_s = key, self._clock.now()
            return key, self._jobs.pop(key), self._n_offs

    def _run(self) -> None:
        """Do the jobs one after another, and store answers and errors, until the job `leave`.

        The answer to a job during which `let_go` was called is thrown away.
        """
        key = _WRITE
        while key != _LEAVE:
            key, job, n_offs = self._next()
            answer: Any = None
            error: Exception | None = None
            try:
                answer = job()
            except Exception as raised:
                error = raised
            with self._changed:
                self._running = None
                if isinstance(error, PortError):
                    self.lose(error)
                elif error is not None:
                    self._error = error  # raised by the next `wait`
                else:
                    if key == _REOPEN:
                        self.lost = None
                    if n_offs == self._n_offs:
                        self._answers[key] = answer
                self._changed.notify_all()


class SeveralBuses:
    """All servos of a face on several buses of any kind, as one `ServoBus`.

    Goals, positions and health pass through in the tick. Orders to single servos (torque on, off,
    restart) are done by the thread of the servo's bus; where that takes longer, the caller must
    call again, as for a servo that did not answer. A port that is lost makes the methods of the
    tick raise PortGone; `disable_all` reaches the buses of all other ports nevertheless.
    """

    def __init__(
        self, buses: Mapping[str, ServoBus], bus_of: Sequence[str], clock: Clock, rate_hz: float
    ) -> None:
        """Prepare the buses, which must not be open; `with` opens them.

        buses: by name. bus_of: the name of each servo's bus. rate_hz: ticks a second.
        """
        names, self._n_servos = np.array(bus_of), len(bus_of)
        self.capabilities = mixed_capabilities(
            {name: bus.capabilities for name, bus in buses.items()}, bus_of
        )
        self._buses, self._bus_of, self._clock = dict(buses), tuple(bus_of), clock
        self._at = {name: np.flatnonzero(names == name) for name in buses}
        self._number = [int((names[:n] == name).sum()) for n, name in enumerate(bus_of)]
        self._period_s = 1.0 / rate_hz
        self._wait_s = max(_SHARE * self._period_s, _LEAST_WAIT_S)
        self._threads: dict[str, BusThread] = {}
        self._remarks: list[str] = []
        self._looked_s = 0.0

    @property
    def torque(self) -> KnownTorque:
        """What is known of every servo's torque now; nothing on a bus that is lost or mute.

        Mute: its present job has taken for half a second. A copy, made anew at every reading; any
        thread may read it.
        """
        known = KnownTorque(self._n_servos)
        for name, at in self._at.items():
            one = self._threads.get(name)
            if one is None or not (one.lost or one.stuck_s >= SILENT_S):
                known.take(at, self._buses[name].torque)
        return known

    def write_positions(self, positions_deg: Array) -> None:
        """Hand every bus its goals; they replace earlier goals that a bus has not sent yet.

        Parameters
        ----------
        positions_deg : Array
            (n_servos,) joint degrees, of all buses.

        Raises
        ------
        ValueError
            positions_deg has another shape.
        """
        check_shape(positions_deg, (self._n_servos,))
        self._check()
        for each in self._threads.values():
            each.hand(_WRITE, partial(each.bus.write_positions, positions_deg[each.at]))

    def widen(self, joints: NDArray[np.bool_]) -> None:
        """Have every bus accept goals beyond the limits, for the given servos only.

        Parameters
        ----------
        joints : NDArray[np.bool_]
            (n_servos,), of all buses: True for servos that may go beyond.
        """
        for each in self._threads.values():
            each.hand(_WIDEN, partial(each.bus.widen, joints[each.at]))

    def read(self) -> Readings:
        """Return the readings of all buses; NaN for a bus that does not answer within .5 s."""
        self._check()
        n = self._n_servos
        found = Readings(
            time_s=self._clock.now(),
            positions_deg=np.full(n, np.nan),
            goals_deg=np.full(n, np.nan),
            torque=np.full(n, Torque.UNKNOWN, dtype=np.int8),
            errors=np.zeros(n, dtype=np.uint8),
            age_s=np.full(n, np.inf),
        )
        threads = self._threads.values()
        for each in threads:
            each.hand(_READ, each.bus.read)
        until_s = time.monotonic() + _READ_S
        for each in threads:
            if each.wait(_READ, until_s - time.monotonic()):
                _put(found, each.at, each.take(_READ))
        self._check()
        return found

    def feedback(self) -> Feedback:
        """Return every servo's feedback; of a bus that is behind, its last one with its age.

        Servos of a bus that has not reported yet have NaN and infinite age. Raises PortGone.
        """
        n = self._n_servos
        self._ask_all(_FEEDBACK, BusThread.hear)
        now_s = self._clock.now()
        newest = [each.feedback[0] for each in self._threads.values() if each.feedback is not None]
        # Only buses whose servos start in turn (hobby servos) report `ready` and `sent_deg`.
        has_stopping_order = any(each.ready is not None for each in newest)
        found = Feedback(
            time_s=now_s,
            positions_deg=np.full(n, np.nan),
            effort=np.full(n, np.nan),
            errors=np.zeros(n, dtype=np.uint8),
            age_s=np.full(n, np.inf),
            ready=np.ones(n, dtype=np.bool_) if has_stopping_order else None,
            sent_deg=np.full(n, np.nan) if has_stopping_order else None,
        )
        for each in self._threads.values():
            if each.feedback is not None:
                feedback, taken_s = each.feedback
                _put(found, each.at, feedback)
                if now_s - taken_s > self._period_s:
                    found.age_s[each.at] += now_s - taken_s
        return found

    def look_after(self) -> Health:
        """Return the health of all servos; each bus polls one of them.

        The servos of a bus that is behind count as silent since its last report.
        """
        n = self._n_servos
        found = Health(
            silent_s=np.full(n, np.inf),
            torque=np.full(n, Torque.UNKNOWN, dtype=np.int8),
            watchdog_tripped=np.zeros(n, dtype=np.bool_),
            hardware_errors=np.zeros(n, dtype=np.uint8),
            temperature_degc=np.full(n, np.nan),
            room_degc=np.full(n, np.inf),
            voltage_v=np.full(n, np.nan),
            effort=np.full(n, np.nan),
            current_ma=np.full(n, np.nan),
            n_unanswered=np.zeros(n, dtype=np.int64),
        )
        self._ask_all(_LOOK, BusThread.look)
        now_s = self._clock.now()
        for each in self._threads.values():
            if each.health is not None:
                health, taken_s = each.health
                _put(found, each.at, health)
                if now_s - taken_s > self._period_s:
                    found.silent_s[each.at] += now_s - taken_s
                if all_set(found.silent_s[each.at] >= SILENT_S):
                    self._remark(f"bus {each.name}: no servo answers; the other buses go on")
        found.torque[:] = self.torque.states  # unknown for a mute bus, unlike its last report
        return found

    def remarks(self) -> Sequence[str]:
        """Return the remarks of every bus, and which bus was lost, for a log."""
        for name, bus in self._buses.items():
            for remark in bus.remarks():
                self._remark(f"{name}: {remark}")
        return self._remarks

    def obstacle(self, index: int) -> str:
        """Return why servo `index` may not get torque, or that its bus is busy; empty: it may."""
        each, n = self._on(index)
        answer = each.ask(("obstacle", n), partial(each.bus.obstacle, n), self._wait_s)
        return _BUSY if answer is None else str(answer)

    def forgive(self, index: int) -> None:
        """Forget what was wrong with servo `index`, since a person has it tried again."""
        each, n = self._on(index)
        each.hand((_FORGIVE, n), partial(each.bus.forgive, n))

    def enable_torque(self, index: int) -> str:
        """Switch one servo's torque on; return "", why it may not, or that its bus is busy.

        While the bus is busy, the caller must call again.
        """
        self._check()
        each, n = self._on(index)
        enable = partial(each.bus.enable_torque, n)
        answer = each.ask(("enable", n), enable, self._wait_s, holds=True)
        return _BUSY if answer is None else str(answer)

    def keep_torque(self, index: int) -> bool:
        """Keep a servo's torque on if it is on; return False if it is off or its bus is busy."""
        each, n = self._on(index)
        keep = partial(each.bus.keep_torque, n)
        return bool(each.ask(("keep", n), keep, self._wait_s, holds=True))

    def disable_torque(self, index: int) -> bool:
        """Switch one servo's torque off; return True once its bus has done it, until then False."""
        each, n = self._on(index)
        # Believed only while the servo is known to be off: it may have come on by itself since.
        if each.was_let_go(n) and each.bus.torque.states.item(n) == Torque.OFF:
            return True
        wait_s = 0.0 if each.is_behind else self._wait_s  # a tick asks again
        return bool(each.ask(("disable", n), partial(each.bus.disable_torque, n), wait_s))

    def disable_all(self) -> NDArray[np.bool_]:
        """Switch all torque off, on all buses at the same time, before any other job of theirs.

        A bus that is busy does it as soon as it can; until then its servos count as not off.

        Returns
        -------
        NDArray[np.bool_]
            (n_servos,): True for servos whose bus switched them off within .1 s.
        """
        there = [each for each in self._opened() if each.lost is None]
        for each in there:
            each.let_go()
        let_go = np.zeros(self._n_servos, dtype=np.bool_)
        until_s = time.monotonic() + _OFF_S
        for each in there:
            if not each.wait(_OFF, until_s - time.monotonic()):
                each.is_behind = True
            let_go[each.at] = [each.was_let_go(n) for n in range(len(each.at))]
        if all(each.lost is not None for each in there):
            self._check()
        return let_go

    def reboot(self, index: int) -> None:
        """Have a servo's bus restart it, without waiting; it comes back limp."""
        each, n = self._on(index)
        each.hand(("reboot", n), partial(each.bus.reboot, n))

    def reopen(self) -> None:
        """Open every lost port again. Raises PortError until all are open."""
        for each in self._opened():
            if each.lost is None:  # what is known of its torque must not grow old
                each.hand(_LOOK, partial(BusThread.look, each))
            else:
                with suppress(BusError):  # one that is still gone keeps no other closed
                    each.ask(_REOPEN, each.bus.reopen, _OPEN_S)
                    each.is_behind = False
        self._check()

    def __enter__(self) -> Self:
        """Open all buses, and start their threads; where one fails, close the others and raise.

        Raises the bus's BusError, with the bus's name.
        """
        with ExitStack() as opened:
            for name, bus in self._buses.items():
                try:
                    opened.enter_context(bus)
                except BusError as error:
                    raise type(error)(f"bus {name}: {error}") from error
            self._threads = {
                name: BusThread(name, bus, self._at[name], self._clock)
                for name, bus in self._buses.items()
            }
            opened.pop_all()  # the threads leave them
            self._looked_s = self._clock.now()
        return self

    def __exit__(self, *exc: object) -> None:
        """Have every bus switch torque off and close its port; wait for that, 2 s at most."""
        threads, self._threads = self._threads.values(), {}
        for each in threads:
            each.leave()
        until_s = time.monotonic() + _END_S
        for each in threads:
            each.thread.join(max(0.0, until_s - time.monotonic()))

    def _ask_all(self, key: _Key, ask: Callable[[BusThread], None]) -> None:
        """Hand every bus the job `ask`; wait up to half a tick for buses that are not behind."""
        self._check()
        threads = self._threads.values()
        for each in threads:
            each.hand(key, partial(ask, each))
        until_s = time.monotonic() + self._wait_s
        for each in threads:
            left_s = 0.0 if each.is_behind else until_s - time.monotonic()
            if not each.wait(key, left_s):
                each.is_behind = True
        self._check()

    def _check(self) -> None:
        """Raise PortGone where a bus is lost, or a job of it has run for more than 5 s.

        Time without a look at the bus does not count: the whole program may have stood still.
        """
        now_s = self._clock.now()
        paused_s, self._looked_s = now_s - self._looked_s - _PAUSE_S, now_s
        for each in self._opened():
            if paused_s > 0.0:
                each.excuse(paused_s)
            if each.lost is None and each.stuck_s > _HUNG_S:
                each.lose(PortError(f"has stood still for {_HUNG_S:g} s"))
            if each.lost is not None:
                self._remark(str(each.lost))
                raise each.lost

    def _opened(self) -> Sequence[BusThread]:
        if not self._threads:
            raise PortError("the bus is used outside its `with` block")
        return tuple(self._threads.values())

    def _on(self, index: int) -> tuple[BusThread, int]:
        """Return the thread of a servo's bus, and the servo's index on that bus."""
        self._opened()
        return self._threads[self._bus_of[index]], self._number[index]

    def _remark(self, text: str) -> None:
        if text not in self._remarks:
            self._remarks.append(text)


def _put(whole: Any, at: NDArray[np.intp], part: Any) -> None:
    """Copy `part`, the arrays of one bus, into `whole`, those of all servos, at indices `at`."""
    for each in fields(whole):
        values = getattr(part, each.name)
        if each.name != "time_s" and values is not None:
            getattr(whole, each.name)[at] = values
