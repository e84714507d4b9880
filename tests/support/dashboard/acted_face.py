"""A shipped face as a dashboard sees it, whose encoders a test sets: a socket and a board."""

import time
from pathlib import Path

import numpy as np
from answering_face import AnsweringFace

from firmware_bridge.loop.face_table import FaceState
from firmware_bridge.process.commands import CommandQueue, Setting
from lipservo.runtime.status.live_board import BoardLayout, LiveBoard, expression_values
from lipservo.settings.settings import load_shipped_face
from lipsync.phonemes import PHONEMES

STATES = tuple(state.value for state in FaceState)
#: A tick; the dashboard looks 30 times a second.
_TICK_S = 0.01


class ActedFace(AnsweringFace):
    """Answers in a thread of its own. What a test sets is told from the next tick on.

    encoders_deg: by servo, NaN: it never answered. said: every stop that came. writes_servos,
    writes_speech: False: that side is gone. answers: False: it hangs. unconfirmed: what its servos
    do not confirm at the next stop, by name. has_bridge: both sides tick on while it is stopped;
    False: they are gone, and a supervisor answers alone.

    A soft stop or limp leads to state `stopped`, as in a daemon, which `start` and then `come_up`
    end; is_daemon: False: it leads to `ended`.
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
        self.writes_servos = self.writes_speech = self.answers = True
        self.has_bridge = self.is_daemon = True
        self.plugged = True
        self.troubles = []
        self.unconfirmed = {}
        self.said = []
        self.starts = 0
        self.come_up()
        self.commands.change({"strength": 1.0})

    def come_up(self):
        """Driven from now on."""
        self.state, self.stopped, self.stop_report = "driven", None, None
        self.writes_servos = self.writes_speech = True

    def stop(self, level):
        """As a person stops it, whoever brings the word."""
        self.said.append(level)
        if level == "freeze":
            self.state, self.stopped = "frozen", level
            return
        self.state, self.stopped = ("stopped", level) if self.is_daemon else ("ended", None)
        self.writes_servos = self.writes_speech = not self.is_daemon or self.has_bridge
        self.stop_report = {
            "complete": not self.unconfirmed,
            "at_rest": level == "soft",
            "dry_run": False,
            "confirmed": [name for name in self.names if name not in self.unconfirmed],
            "unconfirmed": dict(self.unconfirmed),
        }

    def start(self):
        """What `start` answers; the face is then about to be driven, until `come_up`."""
        self.starts += 1
        if self.state != "stopped":
            return {"error": "the face is not stopped"}
        self.state, self.stopped = "the bridge starts", None
        return {"accepted": "start"}

    def _run(self):
        """Write the board, and answer stops and status requests, every tick; run by a thread."""
        while not self._over.wait(_TICK_S):
            self._tell(time.monotonic())
            if not self.answers:
                continue
            stop = self._control.poll()
            self._control.answer(self._status)
            if stop is not None:
                self.stop(stop.level.value)
                if stop.level.value != "freeze":
                    self._control.report_end(self.stop_report)

    def _tell(self, now_s):
        """Write the records of the servo side and the speech side, of those that still write."""
        encoders = np.array([self.encoders_deg[name] for name in self.names])
        if self.writes_servos:
            self.board.write_servos(
                time_s=now_s,
                goal_deg=np.nan_to_num(encoders),
                encoder_deg=encoders,
                state=STATES.index(self.state if self.state in STATES else "stopped"),
                torque_on=self.state in ("driven", "frozen"),
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

    def _servos(self):
        if self.state == "stopped":  # a supervisor that answers alone knows of none how it is
            return dict.fromkeys(self.names, "waiting") if self.has_bridge else {}
        return dict(self.states)

    def _status(self):
        return {
            **self._told,
            "state": self.state,
            "stopped": self.stopped,
            "stopped_by": "process 4711 of user 1000" if self.stopped else "",
            "stop_report": self.stop_report,
            "can_start": self.state == "stopped",
            "plugged": self.plugged,
            "torque_on": self.state == "driven",
            "servos": self._servos(),
            "troubles": [
                *self.troubles,
                *(f"{n}: does not answer" for n, s in self.states.items() if s != "driven"),
            ],
            "settings": self.commands.values,
            "delay_ms": 227.0,
            "n_ticks": 300,
            "n_late": 0,
            "strategy": "expected",
        }
