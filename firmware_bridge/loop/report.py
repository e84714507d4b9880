"""What the bridge tells of itself: one report a tick, and counts since it was made."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.arrays import Array
from firmware_bridge.gate.limits import GateCounts, StaleLevel
from firmware_bridge.health import ServoState


class FaceState(StrEnum):
    """What a face is doing."""

    STOPPED = "stopped"  # limp until it is started
    DRIVEN = "driven"  # follows its targets, as many servos as are well
    SILENT = "silent"  # limp since speech fell silent; driven again at the next fresh target
    EASING = "easing"  # stopped by a person, on its way to rest
    FROZEN = "frozen"  # stopped by a person, held where it is
    LETTING_GO = "letting go"  # torque goes off, again and again until every servo confirms
    ENDED = "ended"  # limp, as far as the servos said so


@dataclass(frozen=True, slots=True)
class TickReport:
    """What one tick wanted, sent and noticed. Every array is (n_servos,).

    wanted_deg is what reached the last gate; sent_deg what the bus got. While `torque_on` is False
    nobody gets goals, sent_deg is where the joints stand, and no limit counts as hit.
    target_age_s counts from the newest target due, or from arming when that is later.
    late is how many ticks were missed before this one.
    """

    time_s: float
    late: int
    wanted_deg: Array
    sent_deg: Array
    target_age_s: float
    stale: StaleLevel
    torque_on: bool
    range_hits: NDArray[np.bool_]
    rate_hits: NDArray[np.bool_]
    rejected: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class BridgeStatus:
    """Counts since the bridge was made, for a status line or a dashboard.

    n_stale: ticks with torque on whose target was no longer fresh; waiting for the first one after
    a start does not count. n_armed: how often the face was brought up: started, spoken to again
    after a silence, plugged in again.
    """

    state: FaceState

    n_ticks: int
    n_late: int
    n_stale: int
    n_armed: int
    n_rejected_targets: int
    gate: GateCounts
    n_unplugged: int
    servo_states: tuple[ServoState, ...]
