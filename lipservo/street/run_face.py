"""One face playing one source from beginning to end, on whatever clock it is given."""

import math
import socket
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from firmware_bridge.clock import Clock, ManualClock
from firmware_bridge.loop.status import face_status
from firmware_bridge.process.command_queue import CommandQueue
from firmware_bridge.process.log_lines import LogLines
from firmware_bridge.process.runtime_folder import socket_path
from firmware_bridge.stopping import StopReport
from lipservo.face.assembly import Face, assemble_face, at_port, check_servos, make_bus
from lipservo.face.face_life import ControlOptions, face_life
from lipservo.speech.speech_side import SpeechSide
from lipservo.status.face_status import Status, whole_status
from lipservo.status.live_board import LiveBoard
from lipservo.status.servo_board import ServoBoard
from lipservo.status.street_tick import StreetTick, TickObserver
from lipservo.street.avatar_stream import avatar_stream, resolved_avatars
from lipservo.street.avatar_targets import AvatarTargets
from lipservo.street.daemon import play
from lipservo.street.motion_options import make_recognizer, make_synthesizer, no_recognizer
from lipservo.street.run_commands import run_commands
from lipservo.street.run_request import RunRequest, about_run
from lipservo.street.sources import warn
from lipservo.street.speech_status import FallbackRecognizer, speech_status
from lipservo.street.street import Street, make_street
from lipservo.street.summary import Summary, Tally
from lipservo.street.voice_agents import voice_agents
from lipservo.street.watched import ServoWatch, watched_street
from lipservo.terminal.output import MESSAGES, say_simulated
from lipservo.traces.trace_writer import BackgroundTrace, TraceFile
from lipsync.audio.playout import Playout
from lipsync.audio.source import AudioSource
from lipsync.face.synthesizer import Synthesizer

#: The mouth closes after the last sound; then the run is over.
_TAIL_S = 0.5


@dataclass(frozen=True, slots=True)
class RunOutcome:
    """What came of a run. status: at its end; signal_number: of the signal that stopped it."""

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
    """Play an entered source to its end or until stopped; the face is limp afterwards.

    live: draw the face in the terminal; endless: go on in silence when the source is over, and wait
    for a start when a person has stopped the face;
    listener: where voice agents connect; synthesizer: of what needs no recogniser; None: whom the
    request's motion asks for.
    """
    began_s = time.perf_counter()
    face = at_port(assemble_face(request.config, request.model), request.port)
    check_servos(face)
    avatars = resolved_avatars(request.avatars)
    rate_hz = face.settings.rate_hz if request.rate_hz is None else request.rate_hz
    length_s = math.inf if endless or source.duration_s is None else source.duration_s
    playout = source if isinstance(source, Playout) else None
    # On a clock of its own nobody waits or looks, and the same file must give the same trace.
    is_live = not isinstance(clock, ManualClock)
    timer_s = time.perf_counter if is_live else None
    motion = request.motion
    if synthesizer is None:
        recognizer = make_recognizer(
            motion.engine, timer_s, motion.weights, motion.recognizer_latency_s
        )
        synthesizer = make_synthesizer(face.model, motion, request.model)
    else:
        recognizer = no_recognizer()
    with make_bus(face, clock) as bus:
        street = make_street(
            face,
            source,
            bus,
            rate_hz,
            recognizer,
            synthesizer,
            dry_run=request.dry_run,
            is_watchable=is_live,
        )
        control_path = request.control or socket_path(face.settings.name)
        run = _Run(request, face, source, street, recognizer)
        delay = street.speech.delay
        if not request.quiet:
            if face.settings.bus.kind == "simulated":
                say_simulated()
            MESSAGES.print(str(request.motion), soft_wrap=True)
            MESSAGES.print(f"delay from sound to face: {delay}")
        tally = Tally(clock, street)
        zero_s = clock.now()
        with (
            watched_street(street, face, request.config, is_watchable=is_live) as board,
            face_life(
                face.settings.name,
                face.settings.servo_port,
                street.bridge,
                clock,
                quiet=request.quiet,
                control=run.control_options(control_path, board, waits=endless),
            ) as life,
            run.observers(clock, rate_hz, avatars, board, live=live) as observers,
            voice_agents(
                listener, street.side, request.voice, face.model, control_path, run.log
            ) as url,
        ):
            run.listens_on = url
            life.start()
            zero_s = clock.now()
            street.begin(zero_s)
            end = _End(zero_s + length_s + delay.total_s, None if endless else playout)
            play(street, life, is_over=end.is_over, tally=tally, observers=observers)
        heard_s = max(0.0, min(length_s, clock.now() - zero_s))
        status = run.status()
    took_s = time.perf_counter() - began_s
    for line in recognizer.take_changes():
        MESSAGES.print(line, soft_wrap=True, markup=False, highlight=False)
    assert life.report is not None
    summary = tally.summary(status, heard_s, took_s)
    return RunOutcome(summary, status, life.report, life.signal_number)


class _End:
    """When a run is over: a little after its sound, of whatever kind, has been shown."""

    def __init__(self, shown_s: float, playout: Playout | None) -> None:
        """shown_s: monotonic; inf: not known. playout: which tells it in place of that."""
        self._shown_s = shown_s
        self._playout = playout

    def is_over(self, now_s: float) -> bool:
        """Whether it is, at monotonic `now_s`."""
        if self._shown_s == math.inf and self._playout is not None and self._playout.is_over:
            self._shown_s = now_s
        return now_s >= self._shown_s + _TAIL_S


@dataclass(frozen=True, slots=True)
class _SettingObserver:
    """Hands changed settings to the speech side, between two ticks."""

    commands: CommandQueue
    side: SpeechSide

    def observe(self, tick: StreetTick) -> None:
        """Look whether somebody has set something."""
        del tick
        if changes := self.commands.take_changes():
            self.side.change(changes)


@dataclass(frozen=True, slots=True)
class _RecognizerLog:
    """A line whenever another recogniser takes over."""

    recognizer: FallbackRecognizer
    log: Callable[[str], None]

    def observe(self, tick: StreetTick) -> None:
        """Pass on what changed in this tick."""
        del tick
        for line in self.recognizer.take_changes():
            self.log(line)


class _Run:
    """The parts of one run, its commands, and how it is."""

    def __init__(
        self,
        request: RunRequest,
        face: Face,
        source: AudioSource,
        street: Street,
        recognizer: FallbackRecognizer,
    ) -> None:
        self._request = request
        self._face = face
        self._source = source
        self._street = street
        self._recognizer = recognizer
        self.commands = run_commands(request.motion, face.settings)
        self.listens_on: str | None = None

    def log(self, line: str) -> None:
        """A line for people, unless --quiet."""
        if not self._request.quiet:
            MESSAGES.print(line, soft_wrap=True, markup=False, highlight=False)

    def status(self) -> Status:
        """The whole face, now."""
        settings = self._face.settings
        about = {"name": settings.name, "port": settings.servo_port}
        return self._whole(
            {**face_status(self._street.bridge), **about, **about_run(self._request)}
        )

    def control_options(self, path: Path, board: LiveBoard, *, waits: bool) -> ControlOptions:
        """How it is commanded and watched. path: of its control socket; waits: for a start."""
        about = about_run(self._request)
        return ControlOptions(path, self.commands, self.describe, about, board.fileno(), waits)

    def describe(self, bridge: Mapping[str, object]) -> Mapping[str, object]:
        """The same for JSON, of what the bridge knows."""
        return self._whole(bridge).as_dict()

    def _whole(self, bridge: Mapping[str, object]) -> Status:
        speech = speech_status(
            self._request.motion,
            self._source,
            self._recognizer,
            self._street.speech,
            self.commands.values,
            self.listens_on,
        )
        return whole_status(bridge, speech)

    @contextmanager
    def observers(
        self, clock: Clock, rate_hz: float, avatars: AvatarTargets, board: LiveBoard, *, live: bool
    ) -> Iterator[list[TickObserver]]:
        """Who watches: settings, trace, avatars, and the view when somebody looks at a terminal."""
        with ExitStack() as stack:
            observers: list[TickObserver] = [_SettingObserver(self.commands, self._street.side)]
            if not isinstance(clock, ManualClock):
                observers.append(ServoWatch(ServoBoard(board, self._street.bridge)))
                log = stack.enter_context(LogLines(write=self.log))
                observers.append(_RecognizerLog(self._recognizer, log))
            if self._request.trace is not None:
                file = TraceFile(self._request.trace, self._trace_header(rate_hz))
                # Where nobody waits for a tick, none may be dropped.
                patient = isinstance(clock, ManualClock)
                watcher = file if patient else BackgroundTrace(file, warn)
                stack.enter_context(watcher)
                observers.append(watcher)
            if avatars.is_any:
                watching = avatar_stream(avatars, self._request.model)
                observers.append(stack.enter_context(watching))
            if live:
                from lipservo.terminal.view import TerminalView

                view = TerminalView(MESSAGES, self.status, self._face.joints, self._face.model)
                observers.append(stack.enter_context(view))
            yield observers

    def _trace_header(self, rate_hz: float) -> dict[str, object]:
        status = self.status()
        return {
            "source": self._source.name,
            "face": self._face.settings.name,
            "servos": [joint.name for joint in self._face.joints],
            "rate_hz": rate_hz,
            "model": self._face.model.checksum,
            "delay_s": round(self._street.speech.delay.total_s, 6),
            "strategy": status.strategy,
            "settings": status.settings,
            "recognizer": status.recognizer,
            "weights": status.weights,
        }
