"""What the servo side tells whoever watches, once a tick."""

import numpy as np

from firmware_bridge.arrays import Array, any_set
from firmware_bridge.health import Feedback
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.report import FaceState, TickReport
from firmware_bridge.loop.servo_supervision import SILENT_S
from lipservo.status.live_board import LiveBoard

#: Of a face, by their numbers on the board.
FACE_STATES = tuple(state.value for state in FaceState)


class ServoBoard:
    """Writes to a `LiveBoard` what was sent and where the servos stand."""

    def __init__(self, board: LiveBoard, bridge: Bridge) -> None:
        self._board = board
        self._bridge = bridge
        self._never = np.full(len(bridge.names), np.nan)
        self._numbers = {state: FACE_STATES.index(state.value) for state in FaceState}

    def tell(self, report: TickReport) -> None:
        """One tick."""
        feedback = self._bridge.feedback
        n_ticks, n_late, n_stale = self._bridge.tick_counts
        self._board.write_servos(
            time_s=report.time_s,
            goal_deg=report.sent_deg,
            encoder_deg=self._never if feedback is None else _answered_deg(feedback),
            effort=self._never if feedback is None else feedback.effort,
            state=self._numbers[self._bridge.state],
            torque_on=report.torque_on,
            n_ticks=n_ticks,
            n_late=n_late,
            n_stale=n_stale,
        )


def _answered_deg(feedback: Feedback) -> Array:
    """NaN for a servo that has said nothing for so long that its goals are withheld."""
    if not any_set(feedback.age_s):  # all answered just now
        return feedback.positions_deg
    return np.where(feedback.age_s > SILENT_S, np.nan, feedback.positions_deg)
