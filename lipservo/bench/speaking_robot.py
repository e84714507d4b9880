"""A robot that speaks on a virtual clock: its servos simulated to the byte, its loudspeaker too.

What the encoders say and which sample left the loudspeaker when are both kept, on one clock.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from calibration.simulated.face import marker_positions_mm, simulated_face
from firmware_bridge.loop.life_cycle import LifeCycle
from lipservo.face.assembly import assemble_face
from lipservo.face.servos import simulated_wire
from lipservo.street.motion_options import MotionOptions, make_recognizer, make_synthesizer
from lipservo.street.street import make_street
from lipsync.arrays import Array
from lipsync.audio.playout import Playout
from lipsync.audio.simulated_loudspeaker import SimulatedLoudspeaker
from lipsync.markers import MARKERS_47

#: A face of ten servos whose geometry is known, so that encoders tell how far its lips are apart.
FACE: Final = "face_sim"
RATE_HZ: Final = 100.0
#: The first words come when the face has been brought up.
_START_S: Final = 0.5


@dataclass(frozen=True, slots=True)
class Watched:
    """What was seen in each tick: times_s (n,), encoder angles (n, n_servos), lip gap in mm (n,).

    zero_s: where the sound's timeline begins, on the same clock.
    """

    times_s: Array
    encoders_deg: Array
    gap_mm: Array
    zero_s: float


class SpeakingRobot:
    """One face with its loudspeaker; `run` lets time pass."""

    def __init__(
        self,
        loudspeaker: SimulatedLoudspeaker | None = None,
        motion: MotionOptions | None = None,
    ) -> None:
        """motion: by default the shipped one, with the recogniser that costs least."""
        face = assemble_face(FACE, None)
        options = motion or MotionOptions(engine="energy")
        self.loudspeaker = loudspeaker or SimulatedLoudspeaker()
        self.playout = Playout(self.loudspeaker)
        self._bus, self.clock = simulated_wire(face.settings)
        self._neutral_mm = face.model.markers_mm(face.model.rest[None])[0]
        self._names = [joint.name for joint in face.joints]
        recognizer = make_recognizer(options.engine, None, options.weights)
        synthesizer = make_synthesizer(face.model, options)
        self.street = make_street(
            face, self.playout, self._bus, RATE_HZ, recognizer, synthesizer
        )

    def run(self, until: Callable[[float], bool]) -> Watched:
        """From the first torque until `until(seconds since the timeline began)` says so."""
        times_s: list[float] = []
        encoders_deg: list[Array] = []
        with self._bus, LifeCycle(self.street.bridge, self.clock) as life:
            life.start()
            zero_s = self.clock.now()
            self.loudspeaker.advance(zero_s)
            self.street.begin(zero_s)
            for time_s, late in life.ticks():
                self.loudspeaker.advance(time_s)
                self.street.tick(time_s, late)
                times_s.append(self.clock.now())
                encoders_deg.append(self._bus.read_positions_deg())
                if until(time_s - zero_s):
                    break
        return Watched(
            np.array(times_s), np.array(encoders_deg), self.gap_mm(np.array(encoders_deg)), zero_s
        )
