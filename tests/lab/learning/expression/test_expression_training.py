import json

import numpy as np
import pytest
from expression_tracks import write_tracks
from lipservo_lab.learning.expression.expression_fit import blink_times_s, fit_blinks
from lipservo_lab.learning.expression.expression_training import train_expression
from lipservo_lab.learning.expression.tracks import TrackError


def test_log_normal_intervals_are_found_though_recordings_are_short():
    """3 s a recording, intervals of 2 s on average: half of them are cut off."""
    rng = np.random.default_rng(0)
    begun_s = np.cumsum(rng.lognormal(0.6, 0.5, 4000))
    shut = np.zeros(round(begun_s[-1] * 25.0) + 10)
    for start in np.round(begun_s * 25.0).astype(int):
        shut[start : start + 3] = 1.0
    pieces = [shut[i : i + 75] for i in range(0, len(shut) - 75, 75)]
    log_mean, log_sd = fit_blinks(pieces)

    assert log_mean == pytest.approx(0.6, abs=0.1)
    assert log_sd == pytest.approx(0.5, abs=0.1)


def test_a_blink_is_counted_once_and_too_few_teach_nothing():
    lid = np.zeros(50)
    lid[[10, 11, 12, 13, 30]] = [0.4, 0.9, 0.6, 0.4, 0.8]

    assert blink_times_s(lid) == pytest.approx([11 / 25.0, 30 / 25.0])
    assert fit_blinks([lid]) is None


def test_what_teaches_nothing_is_refused(tmp_path):
    write_tracks(tmp_path, 2, 3.0)

    with pytest.raises(TrackError, match="6 s of tracks"):
        train_expression(tmp_path)
    (tmp_path / "splits.json").write_text(json.dumps({"random_test": ["t00", "t01"]}))
    with pytest.raises(TrackError, match="every recording is held out"):
        train_expression(tmp_path)
    (tmp_path / "splits.json").write_text(json.dumps({"random_test": 5}))
    with pytest.raises(TrackError, match="no list of names"):
        train_expression(tmp_path)
    (tmp_path / "splits.json").write_text("{")
    with pytest.raises(TrackError, match="no list `random_test`"):
        train_expression(tmp_path)


def test_tracks_that_tell_of_different_things_are_refused(tmp_path):
    write_tracks(tmp_path, 2, 3.0)
    path = tmp_path / "t01.csv"
    rows = [line.split(",")[:4] for line in path.read_text().splitlines()]
    path.write_text("\n".join(",".join(row) for row in rows))

    with pytest.raises(TrackError, match="differ in eye_pitch_deg"):
        train_expression(tmp_path)
