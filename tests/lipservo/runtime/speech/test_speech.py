"""The speech side between any source of phonemes and the servos' targets."""

import math

import numpy as np
import pytest

from firmware_bridge.gate.joint_plan import JointPlan
from firmware_bridge.loop.targets import MemoryTargetChannel
from lipservo.runtime.motion_options import MotionOptions, make_synthesizer
from lipservo.runtime.servos.assembly import assemble_face
from lipservo.runtime.speech.phoneme_sources import RecognizedPhonemes
from lipservo.runtime.speech.speech import Speech, SpeechOptions
from lipservo.runtime.speech.speech_side import SpeechSide, make_speech_side
from lipsync.audio.playback_clock import SteadyClock, clock_for
from lipsync.audio_block import SAMPLE_RATE_HZ, AudioBlock
from lipsync.phonemes import PhonemeEvent
from lipsync.recognition.scripted import ScriptedPhonemes

TICK_S = 1.0 / 30.0


class Card:
    """A sound device on a clock of its own: silence, delivered as it comes."""

    name, duration_s, is_live, lost_blocks = "card", None, True, 0

    def __init__(self, drift: float) -> None:
        self.now_s, self._drift, self._n_given = 0.0, drift, 0

    def blocks(self, until_s: float) -> list[AudioBlock]:
        assert until_s == math.inf
        captured_s = max(0.0, self.now_s - 0.05) * (1.0 + self._drift)
        first, self._n_given = self._n_given, math.floor(captured_s / 0.01)
        silence = np.zeros(SAMPLE_RATE_HZ // 100, np.float32)
        return [AudioBlock(silence, n * 0.01) for n in range(first, self._n_given)]

    def __enter__(self) -> "Card":
        return self

    def __exit__(self, *exc: object) -> None: ...


class Deaf:
    """A recogniser that remembers only until when it heard."""

    latency_s = 0.095

    def __init__(self) -> None:
        self.heard_s = 0.0

    def feed(self, block: AudioBlock) -> None:
        self.heard_s = block.end_s

    def updates(self) -> list[object]:
        return []

    def reset(self) -> None: ...


def speech_of(face, card, ears) -> Speech:
    synthesizer = make_synthesizer(face.model, MotionOptions())
    return Speech(
        RecognizedPhonemes(card, ears),
        clock_for(card),
        synthesizer,
        face.calibration,
        list(face.settings.servos),
        MemoryTargetChannel(),
    )


@pytest.mark.parametrize("drift", [-2e-4, 0.0, 2e-4])
def test_the_sound_of_a_drifting_card_is_shown_with_the_declared_delay(drift):
    face = assemble_face("face_sim", None)
    card, ears = Card(drift), Deaf()
    speech = speech_of(face, card, ears)
    for n in range(60 * 30):  # a minute
        card.now_s = n * TICK_S
        speech.advance(card.now_s)
    shown_s = speech.sound_time_s(card.now_s)
    assert ears.heard_s - shown_s == pytest.approx(speech.delay.total_s, abs=0.05)


class Ears(Deaf):
    """A recogniser that also remembers what it was told of the servos."""

    def __init__(self) -> None:
        super().__init__()
        self.told: list[tuple[float, np.ndarray]] = []

    def note_servo_speeds(self, sound_s: float, speeds_deg_s: np.ndarray) -> None:
        self.told.append((sound_s, speeds_deg_s))


@pytest.mark.parametrize("is_live", [True, False], ids=["device", "file"])
def test_a_device_that_hears_the_servos_is_told_of_them_and_a_file_is_not(is_live):
    """Encoders at 50 Hz; a joint turns at 40 deg/s, and the sound comes 50 ms late."""
    face = assemble_face("face_sim", None)
    card, ears = Card(0.0), Ears()
    card.is_live = is_live
    if not is_live:
        card.blocks = lambda _until_s: []
    names = list(face.settings.servos)
    speech = speech_of(face, card, ears)
    side = SpeechSide(speech)
    for n in range(100):
        card.now_s = n * 0.02
        side.advance(card.now_s)
        side.note_servos(card.now_s, np.full(len(names), 40.0 * card.now_s))
    if not is_live:
        assert ears.told == []
        return
    sound_s, speeds = ears.told[-1]
    assert speeds == pytest.approx(np.full(len(names), 40.0))
    assert sound_s == pytest.approx(card.now_s - 0.02 - 0.05, abs=0.03)


AA = (PhonemeEvent("SIL", 0.0, 0.4), PhonemeEvent("AA", 0.4, 0.8))


def targets_of(
    name: str, until_s: float = 2.0, events=AA, plan=None
) -> tuple[list[str], np.ndarray]:
    """Servo names, and all targets of a face that shows events: (n, n_servos)."""
    face = assemble_face(name, None)
    names, channel = list(face.settings.servos), MemoryTargetChannel()
    synthesizer = make_synthesizer(face.model, MotionOptions())
    script = ScriptedPhonemes(events)
    options = SpeechOptions(plan=plan)
    clock = SteadyClock()
    speech = Speech(script, clock, synthesizer, face.calibration, names, channel, options)
    found = []
    for n in range(round(until_s * 100)):
        speech.advance(n * 0.01)
        found += [targets.positions_deg for targets in channel.drain()]
    return names, np.array(found)


def test_a_face_with_neck_and_eyes_moves_its_mouth_as_one_without_and_keeps_the_rest_at_neutral():
    mouth, alone = targets_of("face_sim")
    names, whole = targets_of("face_head")
    own = [names.index(name) for name in mouth]
    assert np.ptp(alone, axis=0).max() > 5.0
    np.testing.assert_array_equal(whole[:, own], alone)
    others = [n for n in range(len(names)) if n not in own]
    assert len(others) == 6
    assert not whole[:, others].any()


def test_play_of_the_gears_is_taken_up_without_asking_a_servo_beyond_its_speed():
    """`face_eight` has a degree of play; at 150 deg/s its joints are at their limits often."""
    spans = [("SIL", 0.4), ("AA", 0.5), ("P", 0.58), ("IY", 0.7), ("M", 0.78), ("AA", 0.9)]
    starts_s = [0.0, *(end_s for _, end_s in spans)]
    events = [PhonemeEvent(name, at, end) for (name, end), at in zip(spans, starts_s, strict=False)]
    plan = JointPlan(np.full(8, 150.0), np.full(8, np.inf), 0.01)
    _, asked_deg = targets_of("face_eight", events=events, plan=plan)
    steps_deg = np.abs(np.diff(asked_deg, axis=0))

    assert steps_deg.max() <= 1.5
    assert np.count_nonzero(steps_deg > 1.48) > 20


def test_a_calibrated_servo_that_the_face_has_not_is_refused():
    face = assemble_face("face_sim", None)
    synthesizer = make_synthesizer(face.model, MotionOptions())
    with pytest.raises(ValueError, match="jaw"):
        Speech(
            ScriptedPhonemes(()),
            SteadyClock(),
            synthesizer,
            face.calibration,
            list(face.settings.servos)[1:],
            MemoryTargetChannel(),
        )


def test_a_face_is_stopped_before_its_first_sound_and_its_speech_goes_on():
    face = assemble_face("face_head", None)
    card = Card(0.0)
    synthesizer = make_synthesizer(face.model, MotionOptions())
    channel = MemoryTargetChannel()
    side = make_speech_side(face, card, Deaf(), synthesizer, channel, start_s=0.0)
    side.begin(0.0)
    side.follow_stop(0.0, is_stopped=True)
    for n in range(30):
        card.now_s = n * TICK_S
        side.advance(card.now_s)

    assert all(np.isfinite(targets.positions_deg).all() for targets in channel.drain())
