"""A whole street without any sound: phonemes from a label file move simulated servos."""

import numpy as np
from scripted_street import scripted_street
from speech import CLIP_LABELS_PATH

from firmware_bridge.clock import ManualClock, ticks
from lipservo.runtime.servos.assembly import assemble_face, bus_for
from lipsync.phoneme_files.reader import read_phonemes

RATE_HZ = 50.0


def test_a_label_file_drives_the_servos_in_time_without_any_sound():
    """The clip's labels: what is shown is what they say, and P B M shut the lips."""
    events = read_phonemes(CLIP_LABELS_PATH)
    face, clock = assemble_face("face_sim", None), ManualClock()
    with bus_for(face.settings, clock) as bus:
        street = scripted_street(face, events, bus, RATE_HZ)
        street.bridge.start()
        street.begin(clock.now())
        shown = []
        for time_s, late in ticks(clock, RATE_HZ):
            if time_s > 4.0:
                break
            shown.append(street.tick(time_s, late))
    # Nobody recognises anything, so the delay is without that share.
    assert street.speech.delay.recognizer_s == 0.0
    for tick in shown:
        if tick.sound_s > 0.0:
            (said,) = (e for e in events if e.start_s <= tick.sound_s < e.end_s)
            assert tick.phoneme == said.phoneme
    jaw_deg = np.array([tick.report.sent_deg[0] for tick in shown])
    assert np.ptp(jaw_deg) > 5.0
    gaps_mm = {round(t.sound_s, 3): face.model.lip_gap_mm(t.frame.coefficients) for t in shown}
    closed = [e for e in events if e.phoneme in "PBM" and e.start_s > 0.0 and e.end_s < 3.5]
    assert closed
    for event in closed:
        around = [
            gap_mm
            for sound_s, gap_mm in gaps_mm.items()
            if event.start_s - 0.04 <= sound_s <= event.end_s + 0.04
        ]
        assert min(around) <= 1.0


def test_the_bridge_tells_the_speech_side_where_the_servos_stand():
    events = read_phonemes(CLIP_LABELS_PATH)
    face, clock = assemble_face("face_sim", None), ManualClock()
    with bus_for(face.settings, clock) as bus:
        street = scripted_street(face, events, bus, RATE_HZ)
        told = []
        street.side.note_servos = lambda time_s, deg: told.append((time_s, deg.copy()))
        street.bridge.start()
        street.begin(clock.now())
        for time_s, late in ticks(clock, RATE_HZ):
            if time_s > 2.0:
                break
            tick = street.tick(time_s, late)
    assert len(told) >= 95
    time_s, positions_deg = told[-1]
    assert time_s == tick.report.time_s
    assert np.abs(positions_deg - tick.report.sent_deg).max() < 6.0  # a tick and a motor behind
    assert np.ptp([deg[0] for _, deg in told]) > 5.0
