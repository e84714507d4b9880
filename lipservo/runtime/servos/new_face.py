"""The parts of `lipservo new-face`: find servos, nudge one, write the YAML."""

import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from calibration.capture.lerobot_ranges import RecordedRange
from firmware_bridge.bus_kinds import BusKind, bus_kind, kind_at
from firmware_bridge.clock import ManualClock, MonotonicClock
from firmware_bridge.gate.ramp import Ramp
from firmware_bridge.joints import LONGEST_FOUND_US, SHORTEST_FOUND_US
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.report import BridgeSettings
from firmware_bridge.loop.targets import MemoryTargetChannel, ServoTargets
from firmware_bridge.port_names import BUS_NAME
from firmware_bridge.serial_servos.mounting import PositionServo
from firmware_bridge.stopping import StopLevel
from lipservo.runtime.servos.driven_face import DriveOptions, face_life
from lipservo.runtime.servos.face_stopped import FaceStopped
from lipservo.settings.sections import JOINT_NAME
from lipservo.settings.settings import FaceSettings, parse_face
from lipsync.errors import UserError, shown
from lipsync.output_file import check_output

#: The `part` of a servo whose YAML names none.
_MOUTH = "mouth"
NUDGE_DEG = 3.0
#: Seconds for each of the two ways.
_NUDGE_S = 0.25
#: Narrow limits and a low speed at first; the builder of the robot widens them.
_LIMIT_DEG, _SPEED_DEG_S = 10.0, 200.0
#: Pulses of hobby servos: the middle of nearly all of them, and 9 degrees to either side of it.
_NEUTRAL_US, _NARROW_US, _US_PER_DEG = 1500, 100, 11
_MOST_DIGITS = 3
_BOARD = r"[A-Za-z0-9_]{1,20}"
#: Text that is safe in YAML without quotes: it is read as nothing but text.
_PLAIN = r"[a-z]{3,}( [a-z]{3,})*|/[\w./-]+"
_PULSE_HEAD = """\
# Written by `lipservo new-face`: hobby servos on a {kind}. Wiring, power, parts: docs/hardware.md.
#
# 1. lipservo doctor --config THIS               what answers, and what it sends
# 2. lipservo calibrate neutral --yes --config THIS    hands off: servos jump to neutral once
# 3. lipservo jog --dashboard --config THIS      find the limits of each servo, and set them there
# 4. lipservo calibrate --help                   teach it a speaker's mouth, and name the file below

name: {name}
rate_hz: 50                 # as often as most hobby servos take a pulse
# calibration: mine.calibration.yaml

bus:
  kind: {kind}
  {board_key}: {board}
  {port}

# Pulses are neutral_us + us_per_deg x degrees, never outside min_us..max_us. These are narrow on
# purpose: by hand you may go beyond them, slowly, to {least:g} and {most:g} us and no farther.
servos:
"""
_PULSE_SERVO = """\
  {name}:
    channel: {channel}
    positive: {positive:<13} # what a positive angle does
    min_deg: -{deg:<13} # the joint's limits follow those of the pulses
    max_deg: {deg}
    max_speed_deg_s: {speed:<6g} # slow, until it is known to bear more
    us_per_deg: {us_per_deg:<11} # of most servos; a minus turns the joint round
    neutral_us: {neutral:<11} # 0 degrees: where the joint rests
    min_us: {low:<15} # pulses that it bears
    max_us: {high}
"""


_SEVERAL_HEAD = """\
# Written by `lipservo new-face`: a face on several buses. Wiring, power, parts: docs/hardware.md.
# Limits are narrow on purpose: find the real ones by hand.
#
# 1. lipservo doctor --config THIS               what answers on each bus
# 2. lipservo calibrate neutral --yes --config THIS    hands off: hobby servos jump to neutral once
# 3. lipservo jog --dashboard --config THIS      find the limits of each servo, and set them there
# 4. lipservo setup-servos --bus NAME --config THIS    of servos with a memory, once limits are set
# 5. lipservo calibrate --help                   teach it a speaker's mouth

"""


@dataclass(frozen=True, slots=True)
class FoundJoint:
    """A joint whose servo was found on a bus and that a person named; limits in joint degrees."""

    name: str
    servo_id: int
    model: str
    positive: str
    sign: int
    min_deg: float = -_LIMIT_DEG
    max_deg: float = _LIMIT_DEG
    zero_offset_deg: float = 0.0
    part: str = _MOUTH

    def within(
        self,
        recorded: RecordedRange,
        neutral_tick: int,
        model: PositionServo,
        *,
        turns_all_the_way: bool = False,
    ) -> "FoundJoint":
        """Return a copy with the recorded range as limits, and 0 degrees at `neutral_tick`.

        neutral_tick: the servo's present position, without homing offset. model: of the servo, with
        the size of a tick. A range of all positions, as recorded where no one moved the servo,
        leaves the limits as they are, unless the joint `turns_all_the_way`. Raises UserError for a
        neutral outside the range, and for a range that the model does not have.
        """
        if recorded.most_tick >= model.n_positions:
            raise UserError(
                f"{self.name} (id {self.servo_id}): range_max {recorded.most_tick} is beyond an "
                f"{model.name}'s positions, 0 to {model.n_positions - 1}; is that its model?"
            )
        # A servo with a homing offset reports its position plus that; so the range was recorded.
        least, most = (
            tick - recorded.homing_offset_ticks
            for tick in (recorded.least_tick, recorded.most_tick)
        )
        if not least <= neutral_tick <= most:
            raise UserError(
                f"{self.name} (id {self.servo_id}) is at position {neutral_tick}, outside its "
                f"recorded range {least}..{most}; move the face to its neutral"
            )
        limits_deg = sorted(
            round(self.sign * (tick - neutral_tick) / model.pulses_per_deg, 2)
            for tick in (least, most)
        )
        offset_deg = self.sign * (neutral_tick - model.center_pulse) / model.pulses_per_deg
        neutral = replace(self, zero_offset_deg=round(offset_deg, 2))
        if recorded.is_whole(model.n_positions) and not turns_all_the_way:
            return neutral
        return replace(neutral, min_deg=limits_deg[0], max_deg=limits_deg[1])


def nudge(
    tools: Any, port: str, rate: int, servo_id: int, model_name: str
) -> tuple[int, str, bool]:
    """Move one servo by 3 degrees and back, then switch its torque off.

    Returns its position before (encoder ticks), a sentence on the motion that its encoder showed,
    and whether the servo made at least half of the motion. All goals pass the safety gate. tools:
    module for single servos of its kind of bus (`BusKind.workshop`). rate: baud. Raises FaceStopped
    if a person stops the motion, or torque off is not confirmed.
    """
    channel, clock = MemoryTargetChannel(), MonotonicClock()
    start_tick: int
    bus, joint, start_tick = tools.lone_servo(port, rate, servo_id, model_name, NUDGE_DEG + 1.0)
    start_deg, away_deg, moved_deg = np.zeros(1), np.array([NUDGE_DEG]), 0.0
    with bus:
        bridge = Bridge(bus, [joint], channel, BridgeSettings(rate_hz=50.0))
        with face_life("new-face", port, bridge, clock, DriveOptions(quiet=True)) as life:
            life.start()
            ramp_out = Ramp(start_deg, away_deg, clock.now(), _NUDGE_S)
            # 0.5 s after the first has ended.
            ramp_back = Ramp(away_deg, start_deg, ramp_out.start_s + 3.0 * _NUDGE_S, _NUDGE_S)
            for time_s, late in life.ticks():
                ramp = ramp_out if time_s < ramp_back.start_s else ramp_back
                channel.publish(ServoTargets(time_s, ramp.at(time_s)))
                bridge.tick(time_s, late)
                moved_deg = max(moved_deg, abs(float(bus.feedback().positions_deg[0])))
                if ramp_back.is_over(time_s) and not life.stopping:
                    life.stop(StopLevel.LIMP)
    assert life.report is not None
    if life.stopped_by_person or not life.report.complete:
        raise FaceStopped(life.report, life.signal_number)
    if moved_deg >= 0.5 * NUDGE_DEG:
        return start_tick, f"moved by {moved_deg:.1f} degrees", True
    fault = f"was told to move by {NUDGE_DEG:g} degrees and its position changed by {moved_deg:.1f}"
    return start_tick, f"{fault}; look whether it is blocked, or without power", False


def check_face_file(path: Path) -> None:
    """Raise UserError unless `path` is a .yaml or .yml file that can be newly written."""
    if path.suffix not in (".yaml", ".yml"):
        raise UserError(f"{path}: name the face like {path.stem or 'my_face'}.yaml")
    check_output(path)


def check_joint_name(name: str, taken: Sequence[str]) -> str:
    """Return `name` stripped. Raises UserError if invalid for a joint, or one of `taken`."""
    name = name.strip()
    if not re.match(JOINT_NAME, name):
        raise UserError(
            f"{shown(name)} is not a joint's name; use small letters, digits and _, as in upper_lip"
        )
    if name in taken:
        raise UserError(f"joint {name} exists already; choose another name")
    return name


def face_yaml(name: str, kind: BusKind, port: str, rate: int, joints: Sequence[FoundJoint]) -> str:
    """Return the YAML text of a face of serial servos with the joints found, without calibration.

    name: of the face; bytes that are not UTF-8 become "?". rate: baud.
    """
    content = {
        "name": name.encode(errors="replace").decode(),
        "rate_hz": 30,
        "bus": {"kind": kind.name, "port": port, "baud_rate": rate},
        "servos": {
            joint.name: {
                "id": joint.servo_id,
                "model": joint.model,
                "positive": joint.positive,
                "min_deg": joint.min_deg,
                "max_deg": joint.max_deg,
                "max_speed_deg_s": _SPEED_DEG_S,
                "sign": joint.sign,
                **({"zero_offset_deg": joint.zero_offset_deg} if joint.zero_offset_deg else {}),
                **({} if joint.part == _MOUTH else {"part": joint.part}),
            }
            for joint in joints
        },
    }
    head = "# Written by `lipservo new-face`. Limits are careful: find the real ones by hand.\n"
    return head + yaml.safe_dump(content, sort_keys=False)


@dataclass(frozen=True, slots=True)
class WiredJoint:
    """A hobby servo and its channel. positive: the motion that a longer pulse makes, `opens`."""

    name: str
    channel: int
    positive: str


def parse_channel(
    text: str, taken: Sequence[WiredJoint], elsewhere: Sequence[str] = ()
) -> WiredJoint:
    """Parse `NAME=CHANNEL:WORD`, as in `jaw=0:opens`. Raises UserError.

    WORD: the motion that a longer pulse makes. taken: joints of the same board so far; elsewhere:
    names of joints on other buses.
    """
    name, _, wiring = text.partition("=")
    number, _, positive = wiring.partition(":")
    name = check_joint_name(name, [*elsewhere, *(each.name for each in taken)])
    if not number.strip().isdecimal() or len(number) > _MOST_DIGITS:
        raise UserError(f"{shown(text)}: write NAME=CHANNEL:WORD, such as jaw=0:opens")
    if not positive.strip():
        raise UserError(f"{shown(text)}: add what a longer pulse does: {name}={number}:opens")
    channel = int(number)
    if other := next((each.name for each in taken if each.channel == channel), ""):
        raise UserError(f"{name}: channel {channel} belongs to {other}; every servo has its own")
    return WiredJoint(name, channel, positive.strip())


def pulse_face_yaml(
    name: str, kind: BusKind, port: str | None, board: str, joints: Sequence[WiredJoint]
) -> str:
    """Return the YAML text, with comments, of a face of hobby servos, with narrow default limits.

    kind, port, board: of the bus; port None: left out, as a comment. Raises UserError for a board
    that is no word or number; whether it exists is not checked.
    """
    if not re.fullmatch(_BOARD, board):
        raise UserError(f"--board {shown(board)} is not the {kind.board_key} of a {kind.name}")
    where = "# port: ..." if port is None else f"port: {_quoted(port)}"
    head = _PULSE_HEAD.format(
        name=_quoted(name.encode(errors="replace").decode()),
        kind=kind.name,
        board_key=kind.board_key,
        board=board,
        port=where,
        least=SHORTEST_FOUND_US,
        most=LONGEST_FOUND_US,
    )
    entries = (
        _PULSE_SERVO.format(
            name=each.name,
            channel=each.channel,
            positive=_quoted(each.positive),
            speed=_SPEED_DEG_S,
            neutral=_NEUTRAL_US,
            low=_NEUTRAL_US - _NARROW_US,
            high=_NEUTRAL_US + _NARROW_US,
            deg=_NARROW_US // _US_PER_DEG,
            us_per_deg=_US_PER_DEG,
        )
        for each in joints
    )
    return head + "".join(entries)


def check_wiring(text: str, file_name: str) -> FaceSettings:
    """Parse the YAML of a face of hobby servos, check its channels, and return the settings.

    file_name: for messages. Nothing is opened. Raises SettingsError, and ServoError for channels
    that the board lacks.
    """
    settings = parse_face(text, file_name)
    # A bus checks its channels when it is made, and opens its port only when it is entered.
    # Without a port it would check nothing, so a stand-in is given.
    at_port = settings.at_port(settings.bus.port or os.devnull)
    at_port.bus_kind.open(at_port.wiring, ManualClock())
    return settings


def _quoted(text: str) -> str:
    """Return `text` as a YAML scalar, quoted unless it is plain words or a path."""
    if re.fullmatch(_PLAIN, text) and isinstance(yaml.safe_load(text), str):
        return text
    return yaml.safe_dump(text, default_style='"', width=math.inf).rstrip("\n")


@dataclass(frozen=True, slots=True)
class NewBus:
    """One bus of a face that is to be written, from the options that a person typed.

    port, board: None: not given. channels: wirings of hobby servos, as `jaw=0:opens`.
    """

    kind: BusKind
    port: str | None
    board: str | None
    channels: tuple[str, ...]


def parts_of(
    buses: Sequence[str], ports: Sequence[str], boards: Sequence[str], channels: Sequence[str]
) -> dict[str, NewBus]:
    """Parse the bus options of `new-face`, as `maestro` or `lips=maestro`, into buses by name.

    buses, ports, boards: the values of each option as typed, one for each bus; channels: wirings,
    as `jaw=0:opens`. A face with one bus has it under an empty name; {}: neither bus nor port is
    given. Raises UserError for options that do not fit one another.
    """
    if not any("=" in each for each in buses):
        for option, given in (("--bus", buses), ("--port", ports), ("--board", boards)):
            if len(given) > 1:
                raise UserError(
                    f"{option} is given {len(given)} times; for several buses, name each: --bus "
                    "lips=maestro --bus neck=dynamixel"
                )
        if not buses and not ports:
            return {}
        port, board = next(iter(ports), None), next(iter(boards), None)
        kind = bus_kind(buses[0]) if buses else kind_at(port or "")
        for option, is_given in (("--board", board), ("--channel", channels)):
            if is_given and not kind.board_key:
                raise UserError(f"{option} is not for a {kind.name} bus; leave it out")
        return {"": NewBus(kind, port, board, tuple(channels))}
    # Several buses: each option is BUS=VALUE; a channel is BUS/JOINT=..., unless one bus has all.
    kinds = {name: bus_kind(kind) for name, kind in _by_bus("--bus", buses, None).items()}
    hobby = [name for name, kind in kinds.items() if kind.board_key]
    ports_of, boards_of = _by_bus("--port", ports, list(kinds)), _by_bus("--board", boards, hobby)
    wirings: dict[str, list[str]] = {name: [] for name in hobby}
    for each in channels:
        name, slash, wiring = each.rpartition("/")
        if not slash and len(hobby) == 1:
            name = hobby[0]
        if name not in wirings:
            raise UserError(
                f"--channel {shown(each)}: add its bus, as {(hobby or ['lips'])[0]}/{wiring}; "
                f"buses of hobby servos: {', '.join(hobby) or 'none'}"
            )
        wirings[name].append(wiring)
    return {
        name: NewBus(kind, ports_of.get(name), boards_of.get(name), tuple(wirings.get(name, ())))
        for name, kind in kinds.items()
    }


def _by_bus(option: str, given: Sequence[str], known: Sequence[str] | None) -> dict[str, str]:
    """Return the values of an option by bus, from texts NAME=VALUE.

    known: the buses that may be named; None: any. Raises UserError for a malformed text, and for an
    unknown or repeated name.
    """
    found: dict[str, str] = {}
    for each in given:
        name, is_named, value = each.partition("=")
        if not is_named or not value or not re.match(BUS_NAME, name):
            raise UserError(f"{option} {shown(each)}: write NAME=..., as in {option} lips=...")
        if known is not None and name not in known:
            raise UserError(
                f"{option} {shown(each)}: no --bus is so named; known: {', '.join(known) or 'none'}"
            )
        if name in found:
            raise UserError(f"{option}: {name} is given twice; give it once")
        found[name] = value
    return found


def face_on_buses(name: str, texts: Mapping[str, str]) -> str:
    """Return the YAML of one face joined from the YAML texts of its buses, by bus name."""
    parts = {bus: yaml.safe_load(text) for bus, text in texts.items()}
    servos = {
        joint: {"bus": bus, **servo}
        for bus, part in parts.items()
        for joint, servo in part["servos"].items()
    }
    content = {
        "name": name.encode(errors="replace").decode(),
        "rate_hz": max(part["rate_hz"] for part in parts.values()),
        "buses": {bus: part["bus"] for bus, part in parts.items()},
        "servos": servos,
    }
    return _SEVERAL_HEAD + yaml.safe_dump(content, sort_keys=False)
