"""Run a face in one process from start to end, on a real or a manual clock."""

import math
import os
import socket
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from functools import partial

from firmware_bridge.clock import Clock, ManualClock
from firmware_bridge.errors import BusError
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.life_cycle import ImmediateStop, LifeCycle
from firmware_bridge.loop.targets import MemoryTargetChannel
from firmware_bridge.process.logs import LOG_JSON
from firmware_bridge.process.operating_system import ServiceNotice
from firmware_bridge.stopping import StopLevel, StopReport
from lipservo.runtime.face_speech import FaceSpeech
from lipservo.runtime.requested_face import RequestedFace
from lipservo.runtime.run_request import RunRequest
from lipservo.runtime.servos.assembly import check_servos
from lipservo.runtime.servos.driven_face import DriveOptions, driven_face
from lipservo.runtime.status.face_status import SpeechStatus, Status, whole_status
from lipservo.runtime.status.live_board import LiveBoard, ServoBoard
from lipservo.runtime.status.street_tick import StreetTick, TickObserver
from lipservo.runtime.street import Street
from lipservo.runtime.summary import Summary, Tally
from lipservo.terminal.output import MESSAGES, say_simulated
from lipsync.audio.playout import Playout
from lipsync.audio.source import AudioSource
from lipsync.face.frame import Synthesizer

#: After the last sound was shown, the mouth gets so long to close; then the run is over.
_TAIL_S = 0.5


@dataclass(frozen=True, slots=True)
class RunOutcome:
    """The result of a run: its summary, its final status, and the servos' stop report.

    signal_number: number of the signal that stopped the run; None: no signal did.
    """

    summary: Summary
    status: Status
    report: StopReport
    signal_number: int | None


def run_face(
    request: RunRequest,
    source: AudioSource,
    clock: Clock,
    *,
    live: bool = False,
    endless: bool = False,
    listener: socket.socket | None = None,
    synthesizer: Synthesizer | None = None,
) -> RunOutcome:
    """Run a face on an open sound source until its end or a person's stop; switch torque off.

    live: draw the face in the terminal. endless: go on in silence when the source is over, and wait
    for a start command when a person has stopped the face, no dry run. listener: bound socket
    to which voice agents connect; None: no agents. synthesizer: used without any recogniser;
    None: both are made as the request's motion names them. Returns summary, status, stop report
    and signal.
    """
    began_s = time.perf_counter()
    requested = RequestedFace(request)
    check_servos(requested.face)
    request = requested.with_resolved_avatars()
    length_s = math.inf if endless or source.duration_s is None else source.duration_s
    # On a manual clock nobody watches or listens, and the same file must give the same trace.
    is_live = not isinstance(clock, ManualClock)
    channel = MemoryTargetChannel()
    with requested.live_board() as board:
        speech = FaceSpeech(
            requested,
            source,
            channel,
            board=board if is_live else None,
            timer_s=time.perf_counter if is_live else None,
            synthesizer=synthesizer,
        )
        run = _Run(requested, speech)
        options = DriveOptions(
            requested.rate_hz,
            dry_run=request.dry_run,
            quiet=request.quiet,
            control=requested.control(
                run.commands, run.describe, board, waits=endless and not request.dry_run
            ),
        )
        with ExitStack() as stack:
            driven = stack.enter_context(driven_face(requested.settings, clock, channel, options))
            life = driven.life
            street = Street(speech.side, driven.bridge, requested.face.model.rest)
            delay = street.speech.delay
            if not request.quiet:
                if driven.bus.capabilities.in_memory:
                    say_simulated()
                MESSAGES.print(str(request.motion))
                MESSAGES.print(f"delay from sound to face: {delay}")
            tally = Tally(clock, street)
            observers = run.observers(driven.bridge, board, stack, live=live, on_time=is_live)
            if listener is not None:
                from lipservo.runtime.voice_agents import voice_agents

                serving = voice_agents(listener, speech.side, requested)
                run.note_agents_url(stack.enter_context(serving))
            zero_s = math.inf  # while nothing was heard
            try:
                life.start()
                run.notice.ready()
                zero_s = street.side.start(clock.now())
                playout = source if isinstance(source, Playout) and not endless else None
                end = _RunEnd(zero_s + length_s + delay.total_s, playout)
                play(street, life, is_over=end.is_over, tally=tally, observers=observers)
            except (ImmediateStop, BusError):
                # Now: agents, trace and view end before the life cycle, and may take seconds.
                driven.bridge.stop(StopLevel.LIMP)
                raise
        heard_s = max(0.0, min(length_s, clock.now() - zero_s))
        status = run.status(driven.bridge)
    elapsed_s = time.perf_counter() - began_s
    assert life.report is not None
    summary = tally.summary(status, heard_s, elapsed_s)
    return RunOutcome(summary, status, life.report, life.signal_number)


def play(
    street: Street,
    life: LifeCycle,
    *,
    is_over: Callable[[float], bool],
    tally: Tally,
    observers: Sequence[TickObserver] = (),
) -> None:
    """Tick speech and servos until `is_over` or a stop ends the run, then until the face rests.

    While a stopped life cycle waits for a start command, sound is still read and dropped, so that
    no backlog builds up. street: the pipeline from sound to servo goals. life: yields the ticks.
    is_over: called with the monotonic time of each tick; True: the sound is over. tally, observers:
    get every tick.
    """
    for time_s, late in life.ticks():
        if not life.stopping and is_over(time_s):
            life.stop()
        tally.begin_tick(time_s)
        if life.stopping and not life.waits:
            tick = street.rest(time_s, late)
        else:
            street.side.follow_stop(time_s, is_stopped=life.stopping)
            tick = street.tick(time_s, late)
        tally.observe(tick)
        for observer in observers:
            observer.observe(tick)


class _RunEnd:
    """The end of a run: 0.5 s after the face has shown the last of its sound."""

    def __init__(self, shown_s: float, playout: Playout | None) -> None:
        """Set the end. shown_s: monotonic time at which the last sound is shown; inf: not known.

        playout: while `shown_s` is inf, the run ends once this playout is over; None: it never
        does.
        """
        self._shown_s = shown_s
        self._playout = playout

    def is_over(self, now_s: float) -> bool:
        """Return whether the run is over at monotonic `now_s`."""
        if self._shown_s == math.inf and self._playout is not None and self._playout.is_over:
            self._shown_s = now_s
        return now_s >= self._shown_s + _TAIL_S


class _Run:
    """The parts of a run beside speech and servos: commands, status, notices, observers of ticks.

    Itself the observer that passes changed settings on, and notifies systemd.
    """

    def __init__(self, requested: RequestedFace, speech: FaceSpeech) -> None:
        self._requested = requested
        self._speech = speech
        self.commands = requested.commands()
        self.notice = ServiceNotice()
        self._agents_url: str | None = None

    def note_agents_url(self, url: str | None) -> None:
        """Set the URL that the status reports for voice agents; None: no agents are served."""
        self._agents_url = url

    def status(self, bridge: Bridge) -> Status:
        """Return the face's present status: of servos, as `bridge` drives them, and of speech."""
        return self._whole_status({**bridge.as_dict(), **self._requested.about})

    def describe(self, bridge: Mapping[str, object]) -> Mapping[str, object]:
        """Return the whole face's status for JSON, given the servo side's status in `bridge`."""
        return self._whole_status(bridge).as_dict()

    def _whole_status(self, bridge: Mapping[str, object]) -> Status:
        return whole_status(bridge, self._speech_status())

    def _speech_status(self) -> SpeechStatus:
        return self._speech.status(self.commands.values, self._agents_url)

    def observers(
        self, bridge: Bridge, board: LiveBoard, stack: ExitStack, *, live: bool, on_time: bool
    ) -> list[TickObserver]:
        """Return the observers of ticks: settings, live board, trace, avatars, terminal view.

        The request decides which; those to be closed are entered on `stack`. live: draw in the
        terminal. on_time: ticks keep real time, so `board`, shared memory for watchers, is written,
        and a thread that may drop ticks writes the trace (the recorded run), else the tick does.
        """
        request, face = self._requested.request, self._requested.face
        observers: list[TickObserver] = [self]
        if on_time:
            observers.append(ServoBoard(board, bridge))
        if request.trace is not None:
            from lipservo.traces.trace_file import BackgroundTrace, TraceFile

            file = TraceFile(request.trace, self._requested.trace_header(self._speech_status()))
            # In real time a slow disk must not delay a tick; else no tick may be dropped.
            trace: AbstractContextManager[TickObserver] = BackgroundTrace(file) if on_time else file
            observers.append(stack.enter_context(trace))
        if request.avatars.is_any:
            from lipservo.runtime.avatar_stream import avatar_stream

            observers.append(stack.enter_context(avatar_stream(request.avatars, request.model)))
        if live and not os.environ.get(LOG_JSON):
            from lipservo.terminal.view import TerminalView

            view = TerminalView(MESSAGES, partial(self.status, bridge), face.joints, face.model)
            observers.append(stack.enter_context(view))
        return observers

    def observe(self, _tick: StreetTick) -> None:
        """Pass settings changed since the last tick from the command queue to the speech side.

        Called once a tick, as for every `TickObserver`; systemd is notified that ticks go on, also
        those of a stopped face.
        """
        self.notice.alive()
        if changes := self.commands.take_changes():
            self._speech.side.change(changes)
