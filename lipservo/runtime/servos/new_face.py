"""The parts of `lipservo new-face`: find servos, nudge one, write the YAML."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from calibration.capture.lerobot_ranges import TICKS_A_TURN, RecordedRange
from firmware_bridge.bus_kinds import AT_A_PORT
from firmware_bridge.clock import MonotonicClock
from firmware_bridge.gate.ramp import Ramp
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.report import BridgeSettings
from firmware_bridge.loop.targets import MemoryTargetChannel, ServoTargets
from firmware_bridge.stopping import StopLevel
from lipservo.runtime.servos.driven_face import DriveOptions, face_life
from lipservo.runtime.servos.face_stopped import FaceStopped
from lipservo.settings.sections import JOINT_NAME
from lipsync.errors import UserError, shown
from lipsync.output_file import check_output

NUDGE_DEG = 3.0
#: For each of the two ways.
_NUDGE_S = 0.25
_NUDGE_RATE_HZ = 50.0
#: Careful beginnings; the builder widens them.
_LIMIT_DEG, _SPEED_DEG_S = 10.0, 200.0


@dataclass(frozen=True, slots=True)
class FoundJoint:
    """One joint as its servo was found and a person named it; limits in joint degrees."""

    name: str
    servo_id: int
    model: str
    positive: str
    sign: int
    min_deg: float = -_LIMIT_DEG
    max_deg: float = _LIMIT_DEG
    zero_offset_deg: float = 0.0

    def within(self, recorded: RecordedRange, neutral_tick: int) -> "FoundJoint":
        """With the recorded range as limits, and 0 where the servo stands now.

        neutral_tick: without homing offset. Raises UserError where it is outside of that range.
        """
        # A homed servo shows its place plus the homing offset, and so it was recorded.
        least, most = (
            tick - recorded.homing_offset_ticks
            for tick in (recorded.least_tick, recorded.most_tick)
        )
        if not least <= neutral_tick <= most:
            raise UserError(
                f"{self.name} (id {self.servo_id}) stands at {neutral_tick}, outside its recorded "
                f"range {least}..{most}; put the face into its neutral"
            )
        ends_deg = sorted(
            round(self.sign * (tick - neutral_tick) * 360.0 / TICKS_A_TURN, 2)
            for tick in (least, most)
        )
        offset_deg = self.sign * (neutral_tick - TICKS_A_TURN // 2) * 360.0 / TICKS_A_TURN
        return replace(
            self, min_deg=ends_deg[0], max_deg=ends_deg[1], zero_offset_deg=round(offset_deg, 2)
        )


def nudge(tools: Any, port: str, rate: int, servo_id: int, model_name: str) -> int:
    """Move one servo by 3 degrees and back, through the gate; limp afterwards. Where it stood.

    tools: of its kind of bus (`BusKind.workshop`).
    """
    channel, clock = MemoryTargetChannel(), MonotonicClock()
    place: int
    bus, joint, place = tools.lone_servo(port, rate, servo_id, model_name, NUDGE_DEG + 1.0)
    with bus:
        bridge = Bridge(bus, [joint], channel, BridgeSettings(_NUDGE_RATE_HZ))
        with face_life("new-face", port, bridge, clock, DriveOptions(quiet=True)) as life:
            life.start()
            there, back = _nudge_ramps(clock.now())
            for time_s, late in life.ticks():
                ramp = there if time_s < back.start_s else back
                channel.publish(ServoTargets(time_s, ramp.at(time_s)))
                bridge.tick(time_s, late)
                if back.is_over(time_s) and not life.stopping:
                    life.stop(StopLevel.LIMP)
    assert life.report is not None
    if life.stopped_by_person or not life.report.complete:
        raise FaceStopped(life.report, life.signal_number)
    return place


def _nudge_ramps(start_s: float) -> tuple[Ramp, Ramp]:
    """There; and back after a rest that is as long as both ways together."""
    away_deg, here_deg = np.array([NUDGE_DEG]), np.zeros(1)
    return (
        Ramp(here_deg, away_deg, start_s, _NUDGE_S),
        Ramp(away_deg, here_deg, start_s + 3.0 * _NUDGE_S, _NUDGE_S),
    )


def check_face_file(path: Path) -> None:
    """Raises UserError where a new face cannot be written: a file that is there is never lost."""
    if path.suffix not in (".yaml", ".yml"):
        raise UserError(f"{path}: call the face {path.stem or 'my_face'}.yaml")
    check_output(path)


def check_joint_name(name: str, taken: Sequence[str]) -> str:
    """The name that a person typed; UserError where a face cannot have such a joint."""
    name = name.strip()
    if not re.match(JOINT_NAME, name):
        raise UserError(
            f"{shown(name)} is no name of a joint; use small letters, digits and _, as in upper_lip"
        )
    if name in taken:
        raise UserError(f"{name} is another servo of this face already; choose another name")
    return name


def face_yaml(name: str, port: str, rate: int, joints: Sequence[FoundJoint]) -> str:
    """The YAML of a face. name: any text, also of bytes that are no UTF-8."""
    content = {
        "name": name.encode(errors="replace").decode(),
        "rate_hz": 30,
        "bus": {"kind": AT_A_PORT, "port": port, "baud_rate": rate},
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
            }
            for joint in joints
        },
    }
    head = "# Written by `lipservo new-face`. Limits are careful: find the real ones by hand.\n"
    return head + yaml.safe_dump(content, sort_keys=False)
