"""What may be asked of a running face: stops, and the settings that its strategy lets change."""

from collections.abc import Callable

from firmware_bridge.process.command_queue import CommandQueue
from lipservo.status.status_board import StatusBoard
from lipservo.street.motion_options import MotionOptions
from lipservo.street.run_request import RunRequest


def run_commands(
    motion: MotionOptions, on_change: Callable[[str, float], None] | None = None
) -> CommandQueue:
    """The queue of a face that plays like this. on_change: as `CommandQueue` has it."""
    return CommandQueue(
        motion.live_settings(),
        why_none=f"strategy {motion.strategy} has none that change while it runs",
        on_change=on_change,
    )


def shared_commands(request: RunRequest, board: StatusBoard) -> CommandQueue:
    """The same where another process plays: what is set goes onto the board."""

    def write(name: str, value: float) -> None:
        board.write_settings({**board.settings(), name: value})

    return run_commands(request.motion, write)
