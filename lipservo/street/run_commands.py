"""What may be asked of a running face: stops, and the settings that its strategy lets change."""

from collections.abc import Callable, Mapping

from firmware_bridge.process.command_queue import CommandQueue, Setting
from lipservo.settings.motion_names import FARTHEST_LIP_GAP_OFFSET_MM, LIP_GAP_OFFSET
from lipservo.settings.settings import FaceSettings
from lipservo.speech.expression_wishes import expression_settings
from lipservo.status.status_board import StatusBoard
from lipservo.street.motion_options import MotionOptions
from lipservo.street.run_request import RunRequest


def run_commands(
    motion: MotionOptions,
    face: FaceSettings,
    on_change: Callable[[Mapping[str, float]], None] | None = None,
) -> CommandQueue:
    """The queue of a face that plays like this.

    on_change: as `CommandQueue` has it.
    """
    settings = {
        **motion.live_settings(),
        LIP_GAP_OFFSET: Setting(
            face.motion.lip_gap_offset_mm or 0.0,
            -FARTHEST_LIP_GAP_OFFSET_MM,
            FARTHEST_LIP_GAP_OFFSET_MM,
        ),
        **expression_settings(face.expression.amount),
    }
    return CommandQueue(settings, on_change=on_change)


def shared_commands(request: RunRequest, face: FaceSettings, board: StatusBoard) -> CommandQueue:
    """The same where another process plays: what is set goes onto the board."""

    def write(changed: Mapping[str, float]) -> None:
        board.write_settings({**board.settings(), **changed})

    return run_commands(request.motion, face, write)
