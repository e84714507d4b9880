"""The live board of a face without speech: its servos move, its mouth is at rest.

Written by commands that move servos for a person, so that a page draws them as it draws any face.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Self

import numpy as np

from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.report import TickReport
from lipservo.runtime.status.live_board import (
    FACE_STATES,
    BoardLayout,
    LiveBoard,
    ServoBoard,
    expression_values,
)
from lipservo.settings.settings import FaceSettings
from lipsync.face.model import load_face as load_face_model
from lipsync.phonemes import PHONEMES, SILENCE


class SilentBoard:
    """Shared memory with the state of a face without speech. fileno: descriptor for clients."""

    def __init__(self, board: LiveBoard, n_components: int) -> None:
        self._board = board
        self._at_rest = np.zeros(n_components)
        self._servos: ServoBoard | None = None
        self.fileno = board.fileno()

    @classmethod
    @contextmanager
    def create(cls, settings: FaceSettings, config: str) -> Iterator[Self]:
        """Yield a new, open board for a face without speech. config: its name or YAML path."""
        n_components = load_face_model(None).n_components
        servos, rate_hz = tuple(settings.servos), settings.rate_hz
        layout = BoardLayout(
            settings.name, config, servos, FACE_STATES, PHONEMES, n_components, rate_hz
        )
        with LiveBoard.create(layout) as board:
            yield cls(board, n_components)

    def tell(self, bridge: Bridge, report: TickReport) -> None:
        """Write the report of one tick of `bridge`, with a silent mouth.

        bridge: must be the same at every call.
        """
        self._servos = self._servos or ServoBoard(self._board, bridge)
        self._servos.tell(report)
        self._board.write_speech(
            time_s=report.time_s,
            sound_s=0.0,
            phoneme=PHONEMES.index(SILENCE),
            is_speech=0,
            arousal=0.0,
            coefficients=self._at_rest,
            expression=expression_values(),
        )
