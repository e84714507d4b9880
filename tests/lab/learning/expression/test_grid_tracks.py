import json

import numpy as np
import pytest
from lipservo_lab.corpus.utterance import CorpusError
from lipservo_lab.learning.expression.grid_tracks import head_angles_deg, read_grid_tracks
from lipservo_lab.learning.expression.tracks import TrackError
from places import ROOT
from scipy.spatial.transform import Rotation

GRID = ROOT.parent / "shared" / "corpus" / "grid_s1"
LIDS = (160, 159, 158, 144, 145, 153, 387, 386, 385, 373, 374, 380)
RIGID = (33, 133, 362, 263, 10, 168, 127, 356)
IDS = (*RIGID, *LIDS, 468, 473)


def face_mm(open_mm=10.0, gaze_mm=(0.0, 0.0)):
    """A face (n, 3): x to the picture's right, which is the face's own left, y up."""
    points = dict(zip(RIGID, np.random.default_rng(0).normal(0.0, 40.0, (8, 3)), strict=True))
    points |= {33: [-45.0, 0, 0], 133: [-15.0, 0, 0], 362: [15.0, 0, 0], 263: [45.0, 0, 0]}
    for number, lid in enumerate(LIDS):
        centre = -30.0 if number < 6 else 30.0
        upper = number % 6 < 3
        points[lid] = [centre + 3 * (number % 3 - 1), open_mm / 2 * (1 if upper else -1), 2.0]
    points[468] = [-30.0 + gaze_mm[0], gaze_mm[1], 4.0]
    points[473] = [30.0 + gaze_mm[0], gaze_mm[1], 4.0]
    return np.array([points[n] for n in IDS], dtype=np.float64)


def write(folder, frames):
    """frames: of (n, 3) points in mm, y up, z to the viewer; two pixels a millimetre."""
    (folder / "landmarks").mkdir(parents=True)
    about = {"frame_rate_hz": 25.0, "landmark_ids": IDS, "groups": {"rigid": RIGID}}
    (folder / "landmarks.json").write_text(json.dumps(about))
    pixels = np.round(np.array(frames) * 1.5 * [1, -1, -1] * 64 + [9000, 9000, 0])
    np.savez(folder / "landmarks" / "a.npz", landmarks_64th_px=pixels.astype(np.int16))
    return folder


def test_turns_have_the_signs_of_an_expression():
    """Nose and crown of a head that turns; x is the face's own left."""
    turns = Rotation.from_euler("YXZ", [[20, 0, 0], [0, -10, 0], [0, 0, -5]], degrees=True)
    pitch, yaw, roll = head_angles_deg(turns.as_matrix())
    nose, crown = turns.apply([0.0, 0.0, 1.0]), turns.apply([0.0, 1.0, 0.0])

    assert yaw == pytest.approx([20.0, 0.0, 0.0])
    assert nose[0][0] > 0.3  # to its own left
    assert pitch == pytest.approx([0.0, 10.0, 0.0])
    assert nose[1][1] > 0.1  # up
    assert roll == pytest.approx([0.0, 0.0, 5.0])
    assert crown[2][0] > 0.05  # towards its left shoulder


def test_a_head_that_turns_with_its_eyes_ahead_is_a_track_of_the_neck_alone(tmp_path):
    angles = 8.0 * np.sin(np.linspace(0.0, 6.0, 40))
    turns = Rotation.from_euler("YXZ", np.stack((angles, -0.5 * angles, 0 * angles), 1), True)
    track = read_grid_tracks(write(tmp_path, [face_mm() @ r.T for r in turns.as_matrix()]))[0]

    def moved(name):
        return track.values[name] - track.values[name].mean()

    assert moved("neck_yaw_deg") == pytest.approx(angles - angles.mean(), abs=0.3)
    assert moved("neck_pitch_deg") == pytest.approx(0.5 * (angles - angles.mean()), abs=0.3)
    assert np.abs(moved("neck_roll_deg")).max() < 0.3
    assert np.abs(moved("eye_yaw_deg")).max() < 0.3


def test_eyes_and_lids_are_measured_in_the_head(tmp_path):
    opens = np.full(40, 10.0)
    opens[20:23] = 1.0
    sideways = np.where(np.arange(40) < 10, 0.0, 12.0 * np.sin(np.radians(15.0)))
    frames = [face_mm(o, (x, 0.0)) for o, x in zip(opens, sideways, strict=True)]
    values = read_grid_tracks(write(tmp_path, frames))[0].values

    assert values["eye_yaw_deg"][0] - values["eye_yaw_deg"][30] == pytest.approx(-15.0, abs=0.5)
    assert values["lid_left"][20:23] == pytest.approx(1.0, abs=0.02)
    assert values["lid_right"][:20] == pytest.approx(0.0, abs=0.02)


def test_a_folder_without_irises_or_landmarks_is_refused(tmp_path):
    write(tmp_path / "a", [face_mm()] * 20)
    about = {"frame_rate_hz": 25.0, "landmark_ids": RIGID, "groups": {"rigid": RIGID}}
    (tmp_path / "a" / "landmarks.json").write_text(json.dumps(about))

    with pytest.raises(TrackError, match="lacks"):
        read_grid_tracks(tmp_path / "a")
    with pytest.raises(CorpusError, match="no such file"):
        read_grid_tracks(tmp_path / "b")


@pytest.mark.skipif(not GRID.is_dir(), reason="no corpus grid_s1")
def test_the_talker_of_grid_s1_blinks_and_counter_rotates_his_eyes(tmp_path):
    """Both lids together; and against the head, as the vestibulo-ocular reflex has it."""
    (tmp_path / "landmarks").mkdir()
    (tmp_path / "landmarks.json").write_text((GRID / "landmarks.json").read_text())
    for path in sorted((GRID / "landmarks").glob("*.npz"))[::30]:
        (tmp_path / "landmarks" / path.name).symlink_to(path)
    tracks = read_grid_tracks(tmp_path)
    left, right, head, eyes = (
        np.concatenate([t.values[name] - np.median(t.values[name]) for t in tracks])
        for name in ("lid_left", "lid_right", "neck_pitch_deg", "eye_pitch_deg")
    )

    assert np.corrcoef(left, right)[0, 1] > 0.9
    assert np.corrcoef(head, eyes)[0, 1] < -0.2
