"""Moving a face to a pose by hand: the same bus, bridge and gate as speech uses."""

from collections.abc import Mapping

import numpy as np

from firmware_bridge.channel import MemoryTargetChannel
from firmware_bridge.clock import MonotonicClock, ticks
from firmware_bridge.targets import ServoTargets
from lipservo.assembly import load_settings, settings_at_port
from lipservo.servos import bridge_for, bus_for
from lipsync.errors import UserError

#: Slow enough to watch and to stop; no joint is in a hurry here.
_SPEED_DEG_S = 30.0


def move_to(
    config: str, port: str | None, wanted_deg: Mapping[str, float] | None, hold_s: float
) -> dict[str, float]:
    """Lead the named joints, None: all to neutral, and say where every joint stands in the end.

    Raises UserError for a joint or an angle that the face has not; nothing has moved then.
    """
    settings, _ = load_settings(config)
    if port is not None:
        settings = settings_at_port(settings, port)
    joints = settings.joints()
    names = [joint.name for joint in joints]
    for name, angle_deg in (wanted_deg or {}).items():
        if name not in names:
            raise UserError(f"no joint {name!r} in this face; it has {', '.join(names)}")
        joint = joints[names.index(name)]
        if not joint.min_deg <= angle_deg <= joint.max_deg:
            raise UserError(
                f"{name}: {angle_deg:g} deg is outside {joint.min_deg:g}..{joint.max_deg:g}"
            )
    clock = MonotonicClock()
    channel = MemoryTargetChannel()
    with bus_for(settings, clock) as bus:
        bridge = bridge_for(settings, bus, channel)
        start_deg = bus.read().positions_deg
        goal_deg = np.zeros(len(joints)) if wanted_deg is None else start_deg.copy()
        for name, angle_deg in (wanted_deg or {}).items():
            goal_deg[names.index(name)] = angle_deg
        try:
            bridge.arm()
            start_s = clock.now()
            lasts_s = float(np.abs(goal_deg - start_deg).max()) / _SPEED_DEG_S
            for time_s, late in ticks(clock, settings.rate_hz):
                share = min(1.0, (time_s - start_s) / lasts_s) if lasts_s else 1.0
                between_deg = start_deg + share * (goal_deg - start_deg)
                channel.publish(ServoTargets(time_s, between_deg))
                bridge.tick(time_s, late)
                if time_s - start_s > lasts_s + hold_s:
                    break
            reached_deg = bus.read().positions_deg
        finally:
            bridge.stop()
    return dict(zip(names, reached_deg.tolist(), strict=True))
