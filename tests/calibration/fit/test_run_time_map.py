"""What a calibration changes in the live path, and the figures that are claimed."""

import dataclasses
import math

import numpy as np
import pytest
from lipservo_lab.bench.calibration.calibration_figures import own_figures, own_robot
from small_model import small_model

from calibration.calibration import Following
from calibration.fit.learnt_face import fit_calibration
from calibration.mouth_servos import JointRange
from firmware_bridge.loop.targets import MemoryTargetChannel
from lipservo.runtime.speech.speech import PUBLISH_PERIOD_S, Speech
from lipsync.animpho.synthesizer import PublishedSynthesizer
from lipsync.animpho.units import load_face_with_animphos
from lipsync.audio.playback_clock import SteadyClock
from lipsync.phonemes import PhonemeEvent
from lipsync.recognition.scripted import ScriptedPhonemes

MODEL = small_model()
JOINTS = [JointRange("jaw", -2.0, 25.0), JointRange("lip_protrusion", -25.0, 40.0)]
LAG_S = np.array([0.05, 0.02])


class Published(MemoryTargetChannel):
    """The channel, with everything that was ever published."""

    def __init__(self):
        super().__init__()
        self.targets = []

    def publish(self, targets):
        self.targets.append(targets)
        super().publish(targets)


def published(calibration, stalled_s=(math.inf, math.inf)):
    """Times and positions of a second of SIL AA M AA SIL; nothing is computed while stalled."""
    times = (0.0, 0.3, 0.45, 0.6, 0.75, 1.5)
    spoken = ("SIL", "AA", "M", "AA", "SIL")
    events = [PhonemeEvent(*e, 1.0) for e in zip(spoken, times[:-1], times[1:], strict=True)]
    channel = Published()
    speech = Speech(
        ScriptedPhonemes(events),
        SteadyClock(),
        PublishedSynthesizer(MODEL.animphos),
        calibration,
        [joint.name for joint in JOINTS],
        channel,
    )
    for n in range(250):
        if not stalled_s[0] <= n * PUBLISH_PERIOD_S < stalled_s[1]:
            speech.advance(n * PUBLISH_PERIOD_S)
    return speech, channel.targets


@pytest.fixture(scope="module")
def calibration():
    return fit_calibration(MODEL, JOINTS, "x")


def test_late_servos_are_asked_earlier_by_as_much_as_they_are_late(calibration):
    following = Following(LAG_S, np.zeros(2), np.full(2, np.inf), np.full(2, np.inf))
    plain, unhurried = published(calibration)
    hurried, asked = published(dataclasses.replace(calibration, following=following))
    assert hurried.delay.total_s == pytest.approx(plain.delay.total_s + 0.05)
    shown_s = np.array([t.time_s for t in unhurried]) - plain.delay.total_s
    asked_s = np.array([t.time_s for t in asked]) - hurried.delay.total_s
    for joint in range(2):
        wanted = [t.positions_deg[joint] for t in unhurried]
        goals = [t.positions_deg[joint] for t in asked]
        assert np.ptp(wanted) > 1.0
        sound_s = np.arange(0.1, 0.8, 0.01)
        ahead = np.interp(sound_s - LAG_S[joint], asked_s, goals)
        assert ahead == pytest.approx(np.interp(sound_s, shown_s, wanted), abs=0.02)


def test_a_trim_reaches_the_servos_while_its_class_is_spoken(calibration):
    trimmed = dataclasses.replace(calibration, trim={"P": np.array([-1.5, 0.0])})
    speech, plain = published(calibration)
    _, with_trim = published(trimmed)
    sound_s = np.array([t.time_s for t in plain]) - speech.delay.total_s
    added = np.array(
        [b.positions_deg - a.positions_deg for a, b in zip(plain, with_trim, strict=True)]
    )
    late_in_m = (sound_s > 0.54) & (sound_s < 0.6)
    assert added[late_in_m, 0] == pytest.approx(-1.5, abs=0.15)
    assert added[(sound_s > 0.1) & (sound_s < 0.44)] == pytest.approx(0.0)


def test_after_a_stall_the_servos_are_asked_as_if_there_had_been_none(calibration):
    """Lag, backlash and trim remember what the stall skipped; it is worked out for them."""
    following = Following(LAG_S, np.array([1.2, 0.8]), np.full(2, np.inf), np.full(2, np.inf))
    trim = {"P": np.array([-1.5, 2.0]), "AA": np.array([1.0, 0.5])}
    late_and_loose = dataclasses.replace(calibration, following=following, trim=trim)
    _, undisturbed = published(late_and_loose)
    _, stalled = published(late_and_loose, stalled_s=(0.35, 1.35))

    asked = {round(t.time_s, 6): t.positions_deg for t in undisturbed}
    after = [t for t in stalled if t.time_s > 1.2]
    assert len(stalled) <= len(undisturbed) - 80
    assert len(after) > 80
    assert np.ptp([t.positions_deg[0] for t in undisturbed if 0.4 < t.time_s < 1.2]) > 2.0
    for target in after:
        assert target.positions_deg == pytest.approx(asked[round(target.time_s, 6)], abs=1e-6)


@pytest.mark.slow
def test_the_figures_of_one_robot_meet_their_bars():
    """A robot that is not among those that are scored (seeds 0 to 19)."""
    figures = own_figures([own_robot(load_face_with_animphos(), 102)])
    assert figures["heldout_rms_mm"] <= 0.6
    assert figures["reachable"] >= 0.8
    assert figures["guided_rms_mm"] <= 2.5
    assert figures["gap_r"] >= 0.95
    assert figures["closure_touch"] >= 0.98
    assert figures["sync_error_rms_ms"] <= 15.0 < figures["sync_error_before_rms_ms"]
    assert {"worst_rms_mm", "map_us", "procedure_s"} <= set(figures)
