"""Moving a face to a pose on a person's command, through the safety gate, as speech does."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from firmware_bridge.clock import MonotonicClock
from firmware_bridge.stopping import StopLevel, StopReport
from lipservo.runtime.servos.assembly import bus_for
from lipservo.runtime.servos.held_face import HeldFace
from lipservo.settings.settings import FaceSettings
from lipsync.errors import UserError


@dataclass(frozen=True, slots=True)
class Moved:
    """The positions of all joints just before torque off, and the servos' stop report.

    reached_deg: degrees by joint name, measured; for a servo that cannot report its position
    (`is_measured` is False) the goal sent last. sent_deg: that goal of every joint, as the safety
    gate let it pass. is_held: whether each servo was known to hold then, so that this goal was sent
    to it; None: unknown.
    """

    reached_deg: dict[str, float]
    sent_deg: dict[str, float]
    is_measured: dict[str, bool]
    is_held: dict[str, bool | None]
    report: StopReport


def move_to(
    settings: FaceSettings,
    wanted_deg: Mapping[str, float] | None,
    hold_s: float,
    *,
    may_jump: bool = False,
) -> Moved:
    """Move the named joints, wait until still, hold the pose for `hold_s`, then switch torque off.

    settings: of the face, at its port. wanted_deg: joint degrees by name, of joints that the face
    has; None: all joints to neutral. may_jump: servos of unknown position may jump to neutral.
    Returns the positions reached and the stop report. Raises UserError, before any motion, for an
    angle outside its joint's limits.
    """
    joints = settings.joints()
    names = [joint.name for joint in joints]
    wanted_deg = dict.fromkeys(names, 0.0) if wanted_deg is None else wanted_deg
    for name, angle_deg in wanted_deg.items():
        joint = joints[names.index(name)]
        if not joint.min_deg <= angle_deg <= joint.max_deg:
            raise UserError(
                f"{name}: {angle_deg:g} deg is outside {joint.min_deg:g}..{joint.max_deg:g} deg"
            )
    capabilities, clock = settings.capabilities, MonotonicClock()
    has_place = [capabilities.of(index).place for index in range(len(joints))]
    bus = bus_for(settings, clock, may_jump=may_jump)
    with HeldFace(
        settings, clock, bus=bus, joints=names, from_neutral=False, end=StopLevel.LIMP
    ) as face:
        # Joints that are not named stay where they are measured, else at their goals.
        goal_deg = np.where(has_place, face.stands_deg, face.goal_deg)
        for name, angle_deg in wanted_deg.items():
            goal_deg[names.index(name)] = angle_deg
        face.move(goal_deg)
        face.hold(hold_s)
        reached_deg, sent_deg, is_held = face.stands_deg, face.sent_deg, face.torque_on
    assert face.life.report is not None
    return Moved(
        dict(zip(names, reached_deg.tolist(), strict=True)),
        dict(zip(names, sent_deg.tolist(), strict=True)),
        dict(zip(names, has_place, strict=True)),
        dict(zip(names, is_held, strict=True)),
        face.life.report,
    )
