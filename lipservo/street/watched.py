"""What a run tells of itself to whoever watches."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from lipservo.face.assembly import Face
from lipservo.speech.speech_board import SpeechBoard
from lipservo.status.live_board import BoardLayout, LiveBoard
from lipservo.status.servo_board import FACE_STATES, ServoBoard
from lipservo.status.street_tick import StreetTick
from lipservo.street.street import Street
from lipsync.phonemes import PHONEMES


def board_layout(face: Face, config: str, rate_hz: float) -> BoardLayout:
    """What the board of a face says. config: as its run was asked for."""
    return BoardLayout(
        name=face.settings.name,
        config=config,
        servos=tuple(face.settings.servos),
        states=FACE_STATES,
        phonemes=PHONEMES,
        n_components=face.model.n_components,
        rate_hz=rate_hz,
    )


@contextmanager
def watched_street(
    street: Street, face: Face, config: str, *, is_watchable: bool
) -> Iterator[LiveBoard]:
    """The board of a street in one process, which it writes from now on if anybody may look."""
    with LiveBoard.create(board_layout(face, config, street.bridge.rate_hz)) as board:
        if is_watchable:
            street.side.board = SpeechBoard(board, face.model.rest)
        try:
            yield board
        finally:
            street.side.board = None


@dataclass(frozen=True, slots=True)
class ServoWatch:
    """Tells of the servos, each tick."""

    board: ServoBoard

    def observe(self, tick: StreetTick) -> None:
        """See one tick."""
        self.board.tell(tick.report)
