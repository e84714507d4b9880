"""One face playing one source from beginning to end, on whatever clock it is given."""

import math
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from firmware_bridge.clock import Clock, ManualClock
from firmware_bridge.stopping import StopReport
from lipservo.face.assembly import Face, assemble_face, at_port, check_servos, make_bus
from lipservo.face.face_life import face_life
from lipservo.status.street_tick import TickObserver
from lipservo.street.daemon import play
from lipservo.street.motion_options import Manner, make_recognizer, make_synthesizer
from lipservo.street.street import Street, make_street
from lipservo.street.summary import Summary, Tally
from lipservo.terminal.output import MESSAGES, say_simulated
from lipservo.traces.trace_writer import BackgroundTrace, TraceFile
from lipsync.audio.source import AudioSource

#: The mouth closes after the last sound; then the run is over.
_TAIL_S = 0.5


@dataclass(frozen=True, slots=True)
class Played:
    """What came of it. signal_number: of the signal that stopped it, if one did."""

    summary: Summary
    report: StopReport
    signal_number: int | None


@dataclass(frozen=True, slots=True)
class Performance:
    """What the user asked for, apart from the sound.

    live: draw the face in the terminal; endless: go on in silence when the source is over.
    port: speak to the servos there instead of where the face's YAML says.
    dry_run: read the servos, never switch torque on.
    manner: how sound becomes motion.
    """

    config: str
    model: Path | None
    trace: Path | None
    rate_hz: float | None
    live: bool
    quiet: bool
    endless: bool = False
    manner: Manner = field(default_factory=Manner)
    port: str | None = None
    dry_run: bool = False

    def play(self, source: AudioSource, clock: Clock) -> Played:
        """Play an entered source to its end or until stopped; the face is limp afterwards."""
        began_s = time.perf_counter()
        face = at_port(assemble_face(self.config, self.model), self.port)
        check_servos(face)
        rate_hz = face.settings.rate_hz if self.rate_hz is None else self.rate_hz
        length_s = math.inf if self.endless or source.duration_s is None else source.duration_s
        # On a clock of its own nobody waits, and the same file must give the same trace.
        timer_s = None if isinstance(clock, ManualClock) else time.perf_counter
        recognizer = make_recognizer(self.manner.engine, timer_s, self.manner.weights)
        synthesizer = make_synthesizer(face.model, self.manner, self.model)
        with make_bus(face, clock) as bus:
            street = make_street(
                face, source, bus, rate_hz, recognizer, synthesizer, dry_run=self.dry_run
            )
            delay = street.speech.delay
            if not self.quiet:
                if face.settings.bus.kind == "simulated":
                    say_simulated()
                MESSAGES.print(f"delay from sound to face: {delay}")
            tally = Tally(clock, street)
            zero_s = clock.now()
            with (
                face_life(
                    face.settings.name,
                    face.settings.servo_port,
                    street.bridge,
                    clock,
                    rate_hz,
                    quiet=self.quiet,
                ) as life,
                self._observers(face, street, source, clock, rate_hz) as observers,
            ):
                life.start()
                zero_s = clock.now()
                street.begin(zero_s)
                until_s = zero_s + length_s + delay.total_s + _TAIL_S
                play(street, life, until_s=until_s, tally=tally, observers=observers)
            heard_s = max(0.0, min(length_s, clock.now() - zero_s))
        took_s = time.perf_counter() - began_s
        for reason in recognizer.reasons:
            MESSAGES.print(f"recogniser left: {reason}", soft_wrap=True)
        summary = tally.summary(source.name, heard_s, took_s, source.lost_blocks)
        assert life.report is not None
        return Played(
            replace(summary, recognizer=recognizer.level), life.report, life.signal_number
        )

    @contextmanager
    def _observers(
        self, face: Face, street: Street, source: AudioSource, clock: Clock, rate_hz: float
    ) -> Iterator[list[TickObserver]]:
        """Who watches: the trace, and the view when somebody looks at a terminal."""
        with ExitStack() as stack:
            observers: list[TickObserver] = []
            if self.trace is not None:
                header = {
                    "source": source.name,
                    "face": face.settings.name,
                    "servos": [joint.name for joint in face.joints],
                    "rate_hz": rate_hz,
                    "model": face.model.checksum,
                    "delay_s": round(street.speech.delay.total_s, 6),
                }
                file = TraceFile(self.trace, header)
                # Where nobody waits for a tick, none may be dropped.
                patient = isinstance(clock, ManualClock)
                watcher = file if patient else BackgroundTrace(file)
                stack.enter_context(watcher)
                observers.append(watcher)
            if self.live:
                from lipservo.terminal.view import TerminalView

                title = f"{source.name} -> {face.settings.name}"
                view = TerminalView(MESSAGES, title, face.joints, face.model)
                observers.append(stack.enter_context(view))
            yield observers
