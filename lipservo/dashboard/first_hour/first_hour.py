"""The first hour of a face: its setup, from unnamed servos to its first words.

All that the page shows and does is here, so that a page that is reloaded, or opened twice, shows
the present state. Results are in files; only what was typed and not yet written is lost with this
process. Only the running step's process (`StepProcess`) drives servos, never this one. Methods are
called by threads of the server and raise FaceError.
"""

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from copy import deepcopy
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from lipservo_client.protocol import FaceError

from calibration.files.calibration_file import load_calibration
from firmware_bridge.bus_kinds import bus_kind, bus_names, kind_at
from firmware_bridge.errors import BusError
from firmware_bridge.process.runtime_folder import (
    SOCKET_SUFFIX,
    read_socket_name,
    runtime_folder,
)
from lipservo.dashboard.face_link import NothingDrivenError
from lipservo.dashboard.first_hour.step_process import StepProcess
from lipservo.runtime.servos.assembly import load_settings
from lipservo.runtime.servos.letting_go import release
from lipservo.runtime.servos.new_face import (
    FoundJoint,
    WiredJoint,
    check_face_file,
    check_joint_name,
    check_wiring,
    face_yaml,
    parse_channel,
    pulse_face_yaml,
)
from lipservo.runtime.servos.sim_process import SimulatedServos, simulated_servos
from lipservo.settings.found_limits import forget_poses, pose_file, turned_values, with_ranges
from lipservo.settings.settings import FaceSettings, ServoSettings, parse_face
from lipsync.errors import UserError
from lipsync.output_file import write_whole

#: Steps in which servos hold for a person end if no page asked for the state for so long.
PRESENCE_S: Final = 15.0
#: A step that a stop did not reach gets so long for a soft end before it is killed.
_SOFT_END_S: Final = 3.0
_NEEDS_A_PERSON: Final = frozenset({"limits", "jog", "by_eye"})
#: Options of the simulated servos of a rehearsal: a jaw, both corners and a pout are a mouth.
_SIMULATED_SERVOS: Final = ("--servos", "4", "--first-id", "11", "--baud-rate", "1000000")
_S_A_MINUTE: Final = 60.0
JsonObject = dict[str, Any]
#: When a file was written last, and how long it is; None: it is not there.
Stamp = tuple[int, int] | None


def _needed(options: Mapping[str, Any], name: str, step: str) -> Any:
    """Return option `name` of a step. Raises FaceError where it is missing."""
    if options.get(name) is None:
        raise FaceError("refused", f"{step} needs `{name}`")
    return options[name]


class FirstHour:
    """The state of one new face's setup. path: the face's YAML, which need not exist yet."""

    def __init__(
        self,
        path: Path,
        port: str | None = None,
        token_file: Path | None = None,
        *,
        simulated: bool = False,
    ) -> None:
        """Prepare the setup; where a port is given and no YAML exists, find the servos there.

        port: None: as in the YAML, or chosen on the page later. token_file: the token of the face's
        servers. simulated: start simulated servos. Raises UserError for an unfit path or several
        buses.
        """
        if not path.exists():
            check_face_file(path)
        elif load_settings(str(path))[0].buses:
            raise UserError(f"{path}: has several buses; use `lipservo setup-servos --bus`")
        self.path = path
        self._token_file = token_file
        self._lock = threading.RLock()
        self._stack = ExitStack()
        self._simulated: SimulatedServos | None = None
        self._port = port
        self._kind: str | None = None
        self._found: JsonObject | None = None
        self._named: dict[int, FoundJoint] = {}
        self._wired: list[WiredJoint] = []
        self._nudged: set[int] = set()
        #: Angles set by hand, in degrees: by joint, then min, neutral or max.
        self._ends: dict[str, dict[str, float]] = {}
        self._step: StepProcess | None = None
        self._page_seen_s = time.monotonic()
        self._step_times_s: dict[str, float] = {}
        self._ended_well: dict[str, bool] = {}
        self._note: str | None = None
        self._calibration_report: Mapping[str, Any] | None = None
        #: What was read last of the face's YAML and of its calibration, with the file's stamp.
        self._face_read: tuple[Stamp, tuple[FaceSettings | None, str | None]] = None, (None, None)
        self._calibration_read: tuple[Stamp, str] = None, ""
        if simulated:
            self._port = self._start_simulation()
        if self._port is not None and not path.exists():
            self.choose_port(self._port, None, simulated=simulated)

    # ---- what is so ----

    def state(self) -> JsonObject:
        """Return everything that the page draws, as JSON values.

        works: the step that runs; drives: whether it has a control socket; moved: ids of servos
        that were nudged; ends: limits set by hand; keeps: whether captured poses await a fit;
        graded: of a calibration; robot_min: minutes by step; ended_well: by step, of the last time.
        A step in which servos hold for a person ends 15 s after the last call.
        """
        self._page_seen_s = time.monotonic()
        with self._lock:
            settings, trouble = self._read_settings()
            step = self._step
            is_running = step is not None and step.runs
            return {
                "file": str(self.path),
                "trouble": trouble,
                "port": self._port or (None if settings is None else settings.servo_port),
                "kind": self._kind,
                "kinds": {name: self._board_key(name) for name in bus_names()},
                "ports": [] if settings else known_ports(),
                "simulated": self._simulated is not None,
                "found": self._found,
                "named": {str(each): _joint_values(joint) for each, joint in self._named.items()},
                "wired": list(map(asdict, self._wired)),
                "moved": sorted(self._nudged),
                "face": None if settings is None else self._face_values(settings),
                "ends": deepcopy(self._ends),
                "keeps": pose_file(self.path).exists(),
                "step": None if step is None else _step_values(step),
                "drives": self._find_socket() is not None,
                "works": step.step if step is not None and is_running else None,
                "note": self._note,
                "graded": self._calibration_report,
                "robot_min": {k: round(s / _S_A_MINUTE, 2) for k, s in self._step_times_s.items()},
                "ended_well": dict(self._ended_well),
            }

    def control_path(self) -> Path:
        """Return the control socket of the step that runs. Raises UserError before it exists.

        Raises NothingDrivenError where no step runs: no servo is driven then, but only servos that
        confirmed it are limp.
        """
        path, step = self._find_socket(), self._step
        if path is not None:
            return path
        if step is not None and step.runs:
            raise UserError(f"'{step.step}' is still starting and cannot stop yet; try again soon")
        raise self._nothing_driven()

    def let_go(self) -> NothingDrivenError:
        """Switch off the servos of a step that a stop did not reach; return what they confirmed.

        A step that still runs is ended, softly if it answers within 3 s. Torque is then switched
        off from here if the step did not report it. Blocks for some seconds.
        """
        step = self._step
        if step is not None and step.runs:
            step.end(within_s=_SOFT_END_S)
            step.wait()
        with self._lock:
            if step is not None and step is self._step and not (step.runs or step.is_limp):
                self._release_servos(step)
            return self._nothing_driven()

    # ---- what a person does ----

    def choose_port(self, port: str | None, kind: str | None, *, simulated: bool) -> None:
        """Set the servos' port and kind of bus; forget those found, named or wired before.

        Starts the step `find` unless the servos are hobby servos, which cannot be found. port None:
        the bus kind needs none. kind None: by the device at the port. simulated: start simulated
        servos and use their port, until another is chosen. Raises FaceError.
        """
        with self._lock:
            self._check_idle()
            if simulated:
                port, kind = self._start_simulation(), "dynamixel"
            try:
                chosen = bus_kind(kind) if kind else kind_at(port or "")
            except BusError as error:
                raise FaceError("refused", str(error)) from error
            if port is None and not chosen.board_key:
                raise FaceError("refused", "no port is chosen; choose the servos' port")
            if not simulated:
                self._stack.close()
                self._simulated = None
            self._port, self._kind = port, chosen.name
            self._found, self._named, self._wired = None, {}, []
        if not chosen.board_key:
            self.start("find")

    def start(self, step: str, **options: Any) -> None:
        """Start a step's process on the servos. Raises FaceError while another step runs.

        options: of the step, as in `StepBody`.
        """
        with self._lock:
            self._check_idle()
            request: JsonObject = {"port": self._port, "kind": self._kind, **options}
            if step in ("find", "nudge"):
                self._check_port()
                if step == "nudge":
                    servo_id = _needed(options, "id", step)
                    request |= {"rate": self._bus()["rate"], "model": self._model_of(servo_id)}
            else:
                settings, trouble = self._read_settings()
                if settings is None:
                    raise FaceError("not_available", trouble or "no face yet; name its servos")
                if step == "measure":
                    _needed(options, "tracker", step)
                request |= {
                    "config": str(self.path),
                    "port": self._port or settings.servo_port,
                    "output": str(self.path.with_suffix(".calibration.yaml")),
                    "keep": str(pose_file(self.path, step)),
                    "simulated": self._simulated is not None,
                    "token_file": None if self._token_file is None else str(self._token_file),
                }
            self._note = None
            self._page_seen_s = time.monotonic()
            self._step = StepProcess(step, request, may_run=self._may_run(step), on_end=self._store)

    def send_order(self, order: Mapping[str, Any]) -> None:
        """Send an order, the fields of an `OrderBody`, to the step that runs. Raises FaceError."""
        step = self._step
        if step is None or not step.runs:
            raise FaceError("not_available", "no set-up step is running to do this; start it first")
        step.order(order)

    def end_step(self) -> None:
        """End the step that runs softly: the face goes to rest, then torque goes off."""
        if self._step is not None:
            self._step.end()

    def name_servo(self, servo_id: int, name: str, positive: str, part: str, *, same: bool) -> None:
        """Store the name, positive direction and part of a found servo. Raises FaceError.

        positive: what a positive angle does, such as `opens`. same: whether the servo's first
        movement, a positive one, did that; otherwise its sign is reversed.
        """
        with self._lock, _refused_errors():
            model = self._model_of(servo_id)
            taken = [each.name for key, each in self._named.items() if key != servo_id]
            if not positive.strip():
                raise UserError("no direction given; say what a positive angle does, such as opens")
            checked, sign = check_joint_name(name, taken), 1 if same else -1
            joint = FoundJoint(checked, servo_id, model, positive.strip(), sign, part=part)
            parse_face(self._found_face_yaml([joint]), self.path.name)
            self._named[servo_id] = joint

    def change_wiring(self, channel: str) -> None:
        """Add a hobby servo by its wiring, `jaw=0:opens`; remove one by its name alone, `jaw`."""
        with self._lock, _refused_errors():
            wired = [each for each in self._wired if each.name != channel]
            if len(wired) == len(self._wired):
                wired.append(parse_channel(channel, self._wired))
            self._wired = wired

    def write_face(self, board: str | None = None) -> None:
        """Write the face's YAML from the stored servos, over no existing file.

        board: of hobby servos; None: the usual one of their kind of bus. Raises FaceError.
        """
        with self._lock, _refused_errors():
            check_face_file(self.path)
            kind = bus_kind(self._kind or "")
            if kind.board_key:
                if not self._wired:
                    raise UserError("no servos given; say which joint is on which channel")
                board_name = board or kind.usual_board
                text = pulse_face_yaml(self.path.stem, kind, self._port, board_name, self._wired)
                check_wiring(text, self.path.name)
            else:
                missing = [each for each in self._bus()["servos"] if int(each) not in self._named]
                if missing:
                    raise UserError(f"servo id {missing[0]} has no name; give it one")
                text = self._found_face_yaml([self._named[key] for key in sorted(self._named)])
                parse_face(text, self.path.name)
            write_whole(self.path, text)

    def store_limit(self, servo: str, limit: str) -> None:
        """Store the present angle of joint `servo` as its min, neutral or max, as `limit` says.

        Raises FaceError if its angle is not known now, or if its servo holds torque, moves or does
        not answer.
        """
        with self._lock:
            step = self._step
            pose = {} if step is None or step.step != "limits" else step.events.get("turned", {})
            deg = pose.get("deg", {}).get(servo)
            if step is None or not step.runs or deg is None:
                raise FaceError("not_available", f"servo {servo} has not told its angle; try again")
            if (obstacle := pose["obstacles"].get(servo)) is not None:
                raise FaceError("not_available", f"{servo} {obstacle}")
            self._ends.setdefault(servo, {})[limit] = deg

    def write_limits(self) -> None:
        """Write the limits of joints with min and max into the YAML, all or none, then into servos.

        The step `limits` is ended first; captured poses, made with other limits, are deleted. What
        other joints have set stays to be completed. The step `set_up` writes into the servos.
        Raises FaceError while another step runs.
        """
        step = self._step
        if step is not None and step.step == "limits" and step.runs:
            step.end()
            step.wait()
        with self._lock:
            self._check_idle()
            settings, trouble = self._read_settings()
            if settings is None:
                raise FaceError("not_available", trouble or "no face yet; name its servos")
            ready = {name: each for name, each in self._ends.items() if {"min", "max"} <= set(each)}
            if not ready:
                raise FaceError("refused", "no joint has both ends; set min and max of one first")
            with _refused_errors():
                values = {name: _limit_values(name, ends, settings) for name, ends in ready.items()}
                with_ranges(self.path, values).write()
            forget_poses(self.path)
            self._ends = {name: each for name, each in self._ends.items() if name not in ready}
            if settings.capabilities.set_up:
                self.start("set_up")

    def turn_simulated(self, servo: str, by_deg: float) -> None:
        """Rotate a simulated limp servo, as a hand would, by degrees of its joint.

        Raises FaceError for real servos and unknown names.
        """
        settings, _ = self._read_settings()
        if self._simulated is None or settings is None or servo not in settings.servos:
            raise FaceError("refused", "only simulated servos can be turned here")
        sign = settings.servos[servo].sign
        self._simulated.turn(list(settings.servos).index(servo), sign * by_deg)

    def close(self) -> None:
        """End the running step softly, wait for its end, and stop the simulated servos."""
        if self._step is not None:
            self._step.end()
            self._step.wait()
        self._stack.close()

    # ---- parts ----

    def _nothing_driven(self) -> NothingDrivenError:
        """Return the error for a stop while no step runs: what the last step's servos confirmed."""
        text, step = "No step runs: no servo is driven now.", self._step
        if step is not None and step.release_words:
            text += f" {step.release_words}."
        if not (is_limp := step is None or step.is_limp):
            text += " The last step ended without a word of its servos: switch their supply off."
        return NothingDrivenError(text, is_limp=is_limp)

    def _release_servos(self, step: StepProcess) -> None:
        """Switch torque off at the port of a step that ended without reporting it.

        Stores in `step` what the servos confirmed. Blocks for some seconds.
        """
        settings, _ = self._read_settings()
        port = self._port or (None if settings is None else settings.servo_port)
        if port is None:
            return  # servos in memory ended with the step's process
        outcome = release(port, None if settings is None else settings.at_port(port))
        is_confirmed = outcome.is_confirmed and not outcome.released
        step.store_release(outcome.text(), is_confirmed=is_confirmed)

    def _read_settings(self) -> tuple[FaceSettings | None, str | None]:
        """Return (settings, None), (None, None) without a YAML, or (None, why it is unreadable).

        The YAML is read again only when it has changed.
        """
        stamp = _file_stamp(self.path)
        if self._face_read[0] != stamp:
            self._face_read = stamp, (None, None)
            if stamp is not None:
                try:
                    self._face_read = stamp, (load_settings(str(self.path))[0], None)
                except (UserError, OSError) as error:
                    self._face_read = stamp, (None, " ".join(str(error).split()))
        return self._face_read[1]

    def _find_socket(self) -> Path | None:
        """Return the running step's control socket; None while there is no step or no socket."""
        step = self._step
        if step is None or not step.runs or step.pid is None:
            return None
        paths = runtime_folder().glob(f"*-{step.pid}{SOCKET_SUFFIX}")
        return next((path for path in paths if read_socket_name(path)), None)

    def _face_values(self, settings: FaceSettings) -> JsonObject:
        """Return name, servos and calibration of the face's YAML, as JSON values for the page."""
        return {
            "name": settings.name,
            "servos": {name: _servo_values(each) for name, each in settings.servos.items()},
            "has_place": settings.capabilities.place,
            "calibration": settings.calibration if self._has_calibration(settings) else None,
        }

    def _has_calibration(self, settings: FaceSettings) -> bool:
        """Return whether the YAML names a calibration that was made with its present limits."""
        if settings.calibration is None:
            return False
        file = self.path.with_name(settings.calibration)
        stamp = _file_stamp(file)
        if stamp is not None and self._calibration_read[0] != stamp:
            try:
                self._calibration_read = stamp, load_calibration(file).face_checksum
            except UserError:
                self._calibration_read = stamp, ""
        return stamp is not None and self._calibration_read[1] == settings.checksum

    def _found_face_yaml(self, joints: list[FoundJoint]) -> str:
        kind = bus_kind(self._kind or "")
        return face_yaml(self.path.stem, kind, self._port or "", self._bus()["rate"], joints)

    def _bus(self) -> JsonObject:
        """Return what the step `find` reported: `rate`, and `servos`, models by id (as text)."""
        if self._found is None:
            raise FaceError("not_available", "no servos are found yet; find them first")
        return self._found

    def _model_of(self, servo_id: int) -> str:
        models = self._bus()["servos"]
        if str(servo_id) not in models:
            raise FaceError("not_found", f"no servo has id {servo_id}; found: {', '.join(models)}")
        return str(models[str(servo_id)])

    def _board_key(self, kind: str) -> str | None:
        """Return the YAML key of the board if `kind` is a bus of hobby servos; None for others."""
        try:
            return bus_kind(kind).board_key or None
        except BusError:
            return None

    def _check_port(self) -> None:
        if self._port is None:
            raise FaceError("refused", "no port is chosen; choose the servos' port")

    def _check_idle(self) -> None:
        if self._step is not None and self._step.runs:
            step_name = self._step.step.replace("_", " ")
            raise FaceError("not_available", f"step '{step_name}' uses the servos; end it first")

    def _may_run(self, step: str) -> Callable[[], bool]:
        """Return a function that returns whether `step` may go on.

        A step whose servos hold for a person needs an open page, which asks for `state`.
        """

        def page_is_open() -> bool:
            return time.monotonic() - self._page_seen_s < PRESENCE_S

        return page_is_open if step in _NEEDS_A_PERSON else lambda: True

    def _store(self, step: StepProcess) -> None:
        """Store the results of `step`; called in the step's own thread when it has ended."""
        with self._lock:
            if step.was_killed:  # it cannot have switched torque off, and the port is free
                self._release_servos(step)
            self._step_times_s[step.step] = self._step_times_s.get(step.step, 0.0) + step.duration_s
            self._ended_well[step.step] = step.is_limp and step.error is None
            if (bus := step.events.get("found")) is not None:
                self._found = dict(bus)
                self._named, self._nudged = {}, set()
            if (nudged := step.events.get("nudged")) is not None:
                self._nudged.add(int(nudged["id"]))
                self._note = nudged["note"]
            if (report := step.events.get("graded")) is not None:
                self._calibration_report = report
            if step.was_unwatched:
                let_go = "servos were let go; " if step.is_limp else ""
                self._note = f"no browser had this page open: {let_go}kept values stay"

    def _start_simulation(self) -> str:
        if self._simulated is None:
            servos = ("--config", str(self.path)) if self.path.exists() else _SIMULATED_SERVOS
            self._simulated = self._stack.enter_context(simulated_servos(servos))
        return self._simulated.port


def known_ports() -> list[JsonObject]:
    """Return path and description of each USB serial port of this computer."""
    from serial.tools import list_ports

    found = [port for port in list_ports.comports() if port.vid is not None]
    return [{"port": port.device, "what": port.description} for port in sorted(found)]


def _file_stamp(path: Path) -> Stamp:
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size


def _limit_values(name: str, ends: Mapping[str, float], settings: FaceSettings) -> dict[str, float]:
    """Return new YAML values of joint `name`: min_deg, max_deg, zero_offset_deg if it changes.

    ends: its min, max and neutral, in degrees of the present settings; without a neutral 0 stays.
    Raises UserError.
    """
    low_deg, high_deg = sorted((ends["min"], ends["max"]))
    offset_deg = settings.servos[name].zero_offset_deg
    try:
        return turned_values(low_deg, high_deg, ends.get("neutral", 0.0), offset_deg)
    except UserError as error:
        raise UserError(f"{name} {error}") from error


@contextmanager
def _refused_errors() -> Iterator[None]:
    """Convert UserError and BusError into FaceError `refused`, in one line."""
    try:
        yield
    except (UserError, BusError) as error:
        raise FaceError("refused", "; ".join(str(error).splitlines())) from error


def _joint_values(joint: FoundJoint) -> JsonObject:
    return {name: getattr(joint, name) for name in ("name", "positive", "part", "sign")}


def _servo_values(servo: ServoSettings) -> JsonObject:
    names = ("positive", "part", "min_deg", "max_deg")
    return {"id": servo.address, **{name: getattr(servo, name) for name in names}}


def _step_values(step: StepProcess) -> JsonObject:
    """Return the present state of a step of the setup, as JSON values for the page.

    seconds: its duration, or how long it has run; notes: its messages; events: the newest of each
    kind.
    """
    return {
        "name": step.step,
        "runs": step.runs,
        "error": step.error,
        "seconds": round(step.duration_s or time.monotonic() - step.began_s, 1),
        "notes": list(step.notes),
        "events": dict(step.events),
    }
