"""What a bridge knows of its face's status: plain values, names with units."""

import os

from firmware_bridge.health import ServoState
from firmware_bridge.loop.bridge import Bridge


def face_status(bridge: Bridge) -> dict[str, object]:
    """One object for JSON. Made when somebody asks, not in every tick.

    state: a `FaceState`; plugged: whether the port is there; servos: the `ServoState` in words of
    each joint, by name; troubles: a line for each servo that is not driven; jogged: joints that a
    person jogs, by name; health: a `ServoHealth` for each servo that was asked, None for what was
    never heard; *_total: how often the gate stepped in, over all joints; the counts are those of
    `BridgeStatus`.
    """
    status = bridge.status
    gate = {
        f"{name}_total": int(getattr(status.gate, name).sum())
        for name in ("range_hits", "rate_hits", "rejected", "prevented")
    }
    return {
        "state": status.state.value,
        "plugged": bridge.plugged,
        "torque_on": ServoState.DRIVEN in status.servo_states,
        "servos": {
            name: state.word for name, state in zip(bridge.names, status.servo_states, strict=True)
        },
        "troubles": list(bridge.troubles),
        "jogged": list(bridge.jogged),
        "health": bridge.health_records(),
        "n_ticks": status.n_ticks,
        "n_late": status.n_late,
        "n_stale": status.n_stale,
        "n_armed": status.n_armed,
        "n_unplugged": status.n_unplugged,
        "n_rejected_targets": status.n_rejected_targets,
        **gate,
        "bridge_pid": os.getpid(),
    }
