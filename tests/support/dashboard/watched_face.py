"""A face that can be watched and commanded, without servos and speech: a socket and a board.

`python watched_face.py SOCKET` runs one until its standard input closes.
"""

import contextlib
import math
import sys
import time
from pathlib import Path

import numpy as np
from answering_face import AnsweringFace

from firmware_bridge.process.commands import CommandQueue, Setting
from lipservo.runtime.status.live_board import EXPRESSION_NAMES, BoardLayout, LiveBoard
from lipsync.phonemes import PHONEMES

SERVOS = ("jaw", "upper_lip_left", "upper_lip_right", "lower_lip_left", "lower_lip_right",
          "corner_left", "corner_right", "cheek_left", "cheek_right", "neck")  # fmt: skip
LAYOUT = BoardLayout("tom", "face_sim", SERVOS, ("stopped", "driven"), PHONEMES, 8, 100.0)
SETTINGS = {"strength": Setting(1.0, 0.0, 1.5), "expression": Setting(1.0, 0.0, 1.5),
            "look_weight": Setting(0.0, 0.0, 1.0),
            "look_yaw_deg": Setting(0.0, -60.0, 60.0),
            "look_pitch_deg": Setting(0.0, -40.0, 40.0)}  # fmt: skip


class WatchedFace(AnsweringFace):
    """Answers in a thread of its own. said: every stop that came.

    report: of the end, told once, to whoever asked for the next stop.
    """

    def __init__(self, path, status=None, *, writes=True):
        super().__init__("tom", Path(path), CommandQueue(SETTINGS), LiveBoard.create(LAYOUT))
        self.status = {"state": "driven", "servos": dict.fromkeys(SERVOS, "driven"),
                       "troubles": [], **(status or {})}  # fmt: skip
        self.writes_servos = self.writes_speech = writes
        self.answers = True
        self.said = []
        self.report = None

    def tick(self, now_s):
        """One tick of both sides: everything swings, one swing a second."""
        swing = math.sin(2 * math.pi * now_s)
        if self.writes_servos:
            goals = np.linspace(1.0, 20.0, len(SERVOS)) * swing
            self.board.write_servos(
                time_s=now_s, goal_deg=goals, encoder_deg=goals - 0.5, state=1, torque_on=1
            )
        if self.writes_speech:
            self.board.write_speech(
                [abs(swing)],
                time_s=now_s,
                sound_s=now_s,
                phoneme=int(now_s * 10) % len(PHONEMES),
                is_speech=1,
                arousal=0.5 * swing,
                coefficients=np.full(8, swing),
                expression=[swing] * len(EXPRESSION_NAMES),
            )

    def _run(self):
        """Tick, and answer stops and status requests, a hundred times a second; run by a thread."""
        due_s = time.monotonic()
        while not self._over.is_set():
            self.tick(time.monotonic())
            if self.answers:
                stop = self._control.poll()
                self._control.answer(self._described)
                if stop is not None:
                    self.said.append(stop.level.value)
                    if self.report is not None:
                        self._control.report_end(self.report)
                        self.report = None
            due_s = max(due_s + 0.01, time.monotonic() - 0.05)
            time.sleep(max(0.0, due_s - time.monotonic()))

    def _described(self):
        motion = ("strength", "smoothness")
        now = self.commands.values
        settings = {"lookahead_ms": 100.0, **{name: now[name] for name in motion if name in now}}
        wishes = {name: value for name, value in now.items() if name not in motion}
        return {**self.status, "settings": settings, "expression": wishes}


if __name__ == "__main__":
    with WatchedFace(sys.argv[1]), contextlib.suppress(KeyboardInterrupt):
        sys.stdin.read()
