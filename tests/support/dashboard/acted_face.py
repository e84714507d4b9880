"""A shipped face as a dashboard sees it, whose encoders a test sets: a socket and a board."""

import time
from pathlib import Path

import numpy as np
from answering_face import AnsweringFace

from firmware_bridge.loop.report import FaceState
from firmware_bridge.process.command_queue import CommandQueue, Setting
from lipservo.settings.settings import load_shipped_face
from lipservo.status.live_board import BoardLayout, LiveBoard, expression_values
from lipsync.phonemes import PHONEMES

STATES = tuple(state.value for state in FaceState)
#: A tick; the dashboard looks 30 times a second.
_TICK_S = 0.01


class ActedFace(AnsweringFace):
    """Answers in a thread of its own. What a test sets is told from the next tick on.

    encoders_deg: by servo, NaN: it never answered. said: every stop that came. writes_servos,
    writes_speech: False: that side is gone.
    """

    def __init__(self, folder, config="face_head", sounds=None):
        self.settings = load_shipped_face(config)
        self.names = tuple(self.settings.servos)
        layout = BoardLayout(self.settings.name, config, self.names, STATES, PHONEMES, 8, 30.0)
        commands = CommandQueue(
            {
                "strength": Setting(1.0, 0.0, 1.5),
                "smoothness": Setting(0.0, 0.0, 1.0),
                "expression": Setting(1.0, 0.0, 1.5),
            }
        )
        self._told = {"config": config, "sounds": None if sounds is None else str(sounds)}
        path = Path(folder) / "face.sock"
        super().__init__(self.settings.name, path, commands, LiveBoard.create(layout))
        self.rest()

    def rest(self):
        """As it was made: driven, at 0 degrees, silent."""
        self.encoders_deg = dict.fromkeys(self.names, 0.0)
        self.states = dict.fromkeys(self.names, "driven")
        self.phoneme = "SIL"
        self.coefficients = np.zeros(8)
        self.is_driven = True
        self.writes_servos = self.writes_speech = True
        self.unconfirmed = {}
        self.said = []
        self.commands.change({"strength": 1.0})

    def _run(self):
        while not self._over.wait(_TICK_S):
            self._tell(time.monotonic())
            stop = self._control.poll()
            self._control.answer(self._status)
            if stop is not None:
                self.said.append(stop.level.value)
                self.is_driven = False
                confirmed = [name for name in self.names if name not in self.unconfirmed]
                self._control.report_end(
                    {
                        "complete": not self.unconfirmed,
                        "at_rest": stop.level.value == "soft",
                        "confirmed": confirmed,
                        "unconfirmed": self.unconfirmed,
                    }
                )

    def _tell(self, now_s):
        encoders = np.array([self.encoders_deg[name] for name in self.names])
        if self.writes_servos:
            self.board.write_servos(
                time_s=now_s,
                goal_deg=np.nan_to_num(encoders),
                encoder_deg=encoders,
                state=STATES.index("driven" if self.is_driven else "ended"),
                torque_on=self.is_driven,
            )
        if self.writes_speech:
            is_speech = self.phoneme != "SIL"
            self.board.write_speech(
                [0.5 * is_speech],
                time_s=now_s,
                sound_s=now_s,
                phoneme=PHONEMES.index(self.phoneme),
                is_speech=is_speech,
                arousal=0.0,
                coefficients=self.coefficients,
                expression=expression_values(),
            )

    def _status(self):
        return {
            **self._told,
            "state": "driven" if self.is_driven else "ended",
            "torque_on": self.is_driven,
            "servos": dict(self.states),
            "troubles": [f"{n}: does not answer" for n, s in self.states.items() if s != "driven"],
            "settings": self.commands.values,
            "delay_ms": 227.0,
            "n_ticks": 300,
            "n_late": 0,
            "strategy": "expected",
        }
