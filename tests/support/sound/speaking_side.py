"""A speech side with its own voice, a simulated loudspeaker and no servos: goals are what is seen.

`lipservo_lab.bench.sync.speaking_robot` is the same with servos, and ten times slower.
"""

import numpy as np
from lipservo_lab.bench.sync.speaking_robot import (
    FACE,
    RATE_HZ,
    Deaf,
    SimulatedLoudspeaker,
    Watched,
)

from calibration.simulated.face import marker_positions_mm, simulated_face
from firmware_bridge.loop.targets import MemoryTargetChannel
from lipservo.runtime.motion_options import MotionOptions, make_synthesizer
from lipservo.runtime.servos.assembly import assemble_face
from lipservo.runtime.speech.speech_side import make_speech_side
from lipsync.audio.playout import Playout
from lipsync.markers import MARKERS_47

#: The monotonic clock begins anywhere.
ZERO_S = 100.0


class SpeakingSide:
    """`run` lets time pass, once; times told to `act` count from the beginning."""

    def __init__(self, loudspeaker=None, microphone=None, recognizer=None):
        self.face = assemble_face(FACE, None)
        self.loudspeaker = loudspeaker or SimulatedLoudspeaker()
        self.playout = Playout(self.loudspeaker, microphone)
        self.now_s = 0.0
        self.n_held = 0
        self._channel = MemoryTargetChannel()
        synthesizer = make_synthesizer(self.face.model, MotionOptions())
        heard_by = recognizer or Deaf()
        self.side = make_speech_side(
            self.face, self.playout, heard_by, synthesizer, self._channel, start_s=0.0
        )
        self.delay = self.side.speech.delay

    def run(self, until_s, act=lambda _now_s: None, *, holds=False):
        """holds: at rest four of five periods are not worked out, as in a daemon."""
        goals, self.n_held = [], 0
        self.loudspeaker.advance(ZERO_S)
        self.side.begin(ZERO_S)
        times_s, seen_deg = np.arange(round(until_s * RATE_HZ)) / RATE_HZ, []
        for now_s in times_s:
            self.now_s = float(now_s)
            self.loudspeaker.advance(ZERO_S + self.now_s)
            act(self.now_s)
            if holds and self.side.hold(ZERO_S + self.now_s, has_news=False):
                self.n_held += 1
            else:
                self.side.advance(ZERO_S + self.now_s)
            for targets in self._channel.drain():
                # Goals of a mouth that is cut off replace what was planned beyond.
                goals = [each for each in goals if each[0] < targets.time_s]
                goals.append((targets.time_s, targets.positions_deg))
            seen_deg.append(_at(goals, ZERO_S + self.now_s))
        encoders_deg = np.array(seen_deg)
        return Watched(times_s + ZERO_S, encoders_deg, self._gap_mm(encoders_deg), ZERO_S)

    def stop(self):
        """What a face does that is stopped, for a second."""
        for _ in range(100):
            self.now_s += 1.0 / RATE_HZ
            self.loudspeaker.advance(ZERO_S + self.now_s)
            self.side.fall_silent()

    def _gap_mm(self, positions_deg):
        neutral_mm = self.face.model.markers_mm(self.face.model.rest[None])[0]
        face = simulated_face(neutral_mm, list(self.face.settings.servos))
        markers_mm = marker_positions_mm(face, positions_deg)
        upper, lower = markers_mm[:, MARKERS_47.upper_lip], markers_mm[:, MARKERS_47.lower_lip]
        return upper[:, 1] - lower[:, 1]


def _at(goals, time_s):
    """Between the two goals around, as the bridge does."""
    while len(goals) > 2 and goals[1][0] <= time_s:
        goals.pop(0)
    if len(goals) == 1 or goals[0][0] >= time_s:
        return goals[0][1]
    (before_s, before_deg), (after_s, after_deg) = goals[:2]
    share = min(1.0, (time_s - before_s) / (after_s - before_s))
    return before_deg + share * (after_deg - before_deg)
