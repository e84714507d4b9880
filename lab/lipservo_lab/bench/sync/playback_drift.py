"""How far lips and sound drift apart over minutes, where the sound card's clock is wrong."""

from typing import Final

import numpy as np

from firmware_bridge.loop.channel import MemoryTargetChannel
from lipservo.face.assembly import assemble_face
from lipservo.speech.speech_side import make_speech_side
from lipservo.street.motion_options import MotionOptions, make_synthesizer
from lipservo_lab.bench.sync.simulated_loudspeaker import SimulatedLoudspeaker
from lipservo_lab.bench.sync.speaking_robot import FACE, RATE_HZ, Deaf
from lipsync.audio.playout import Playout

#: Found within a second of the start, the device's own latency is no drift.
_SETTLED_S: Final = 5.0
_DEVICE_HZ: Final = 8_000


def drift_s(skew: float, duration_s: float, *, jitter_s: float = 0.005) -> float:
    """The largest distance between the sound that is shown and the sound that is heard, seconds.

    skew: how much too fast the loudspeaker's clock is; jitter_s: how far off its reports are.
    """
    face = assemble_face(FACE, None)
    loudspeaker = SimulatedLoudspeaker(_DEVICE_HZ, 0.08, skew, jitter_s)
    playout = Playout(loudspeaker)
    synthesizer = make_synthesizer(face.model, MotionOptions())
    side = make_speech_side(
        face, playout, Deaf(), synthesizer, MemoryTargetChannel(), has_soft_start=False
    )
    now_s = np.arange(round(duration_s * RATE_HZ)) / RATE_HZ
    shown_s = np.empty(len(now_s))
    loudspeaker.advance(0.0)
    side.begin(0.0)
    for n, time_s in enumerate(now_s):
        loudspeaker.advance(float(time_s))
        side.advance(float(time_s))
        shown_s[n] = side.speech.sound_time_s(float(time_s))
    samples, left_s = loudspeaker.played()
    positions_s = np.arange(len(samples)) / _DEVICE_HZ - playout.preroll_s
    settled = (now_s > _SETTLED_S) & (now_s < left_s[-1])
    heard_s = np.interp(now_s[settled], left_s, positions_s)
    return float(np.abs(shown_s[settled] - heard_s).max())
