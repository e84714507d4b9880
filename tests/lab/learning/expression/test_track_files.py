import numpy as np
import pytest
import soundfile
from expression_tracks import COLUMNS, write_csv
from lipservo_lab.learning.expression.tracks import TrackError, read_track_file, read_track_files

N_ROWS = 60


def rows(n=N_ROWS, rate_hz=30.0):
    t_s = np.arange(n) / rate_hz
    return np.column_stack((t_s, *[k * t_s for k in range(1, 8)]))


def written(folder, table=None, columns=COLUMNS, sound="a.wav"):
    soundfile.write(folder / sound, np.zeros(32_000), 16_000)
    return write_csv(folder / "a.csv", rows() if table is None else table, columns)


def test_30_hz_become_25(tmp_path):
    track = read_track_file(written(tmp_path))

    assert track.name == "a"
    assert track.n_frames == 50  # 59 / 30 s
    frames_s = np.arange(50) / 25.0
    assert track.values["neck_pitch_deg"] == pytest.approx(frames_s, abs=1e-3)
    assert track.values["lid_right"] == pytest.approx(7.0 * frames_s, abs=1e-2)
    assert track.sound_path == tmp_path / "a.wav"


def test_the_neck_alone_is_enough(tmp_path):
    track = read_track_file(written(tmp_path, rows()[:, :4], COLUMNS[:4], "a.flac"))

    assert set(track.values) == set(COLUMNS[1:4])


def test_a_folder_is_read_in_the_order_of_its_names(tmp_path):
    for name in ("b", "a"):
        soundfile.write(tmp_path / f"{name}.wav", np.zeros(32_000), 16_000)
        write_csv(tmp_path / f"{name}.csv", rows())

    assert [track.name for track in read_track_files(tmp_path)] == ["a", "b"]


def _with(row, column, value):
    table = rows()
    table[row, column] = value
    return table


@pytest.mark.parametrize(
    ("table", "columns", "words"),
    [
        (rows()[:, :3], COLUMNS[:3], "lacks the column neck_roll_deg"),
        (rows()[:, :5], COLUMNS[:5], "lacks the column eye_pitch_deg"),
        (rows()[:, 1:], COLUMNS[1:], "lacks the column time_s"),
        (rows(), (*COLUMNS[:-1], "wings"), "no such column: wings"),
        (rows(), (*COLUMNS[:-1], "lid_left"), "twice"),
        (rows()[:1], COLUMNS, "fewer than two rows"),
        (rows(8), COLUMNS, "half a second"),
        (_with(5, 2, np.nan), COLUMNS, "line 7, neck_yaw_deg: 'nan' is no number"),
        (_with(5, 2, 400.0), COLUMNS, "line 7, neck_yaw_deg: 400 degrees"),
        (_with(5, 0, 0.0), COLUMNS, "does not grow"),
        (rows(4, 1.5), COLUMNS, "nothing for 0.67 s after"),
    ],
)
def test_a_table_that_cannot_be_used_is_refused_in_one_line(tmp_path, table, columns, words):
    path = written(tmp_path, table, columns)

    with pytest.raises(TrackError, match=words) as refused:
        read_track_file(path)
    assert str(refused.value).startswith(f"{path}: ")
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "lacks the column"),
        (b"\xff\xfe\x00", "cannot be read as CSV"),
        (b"time_s,neck_pitch_deg,neck_yaw_deg,neck_roll_deg\n0,1,2\n1,2,3,4\n", "line 2 has 3"),
        (b"time_s,neck_pitch_deg,neck_yaw_deg,neck_roll_deg\n0,1,2,x\n1,2,3,4\n", "'x'"),
    ],
)
def test_a_file_that_is_no_table_is_refused(tmp_path, content, words):
    path = written(tmp_path)
    path.write_bytes(content)

    with pytest.raises(TrackError, match=words):
        read_track_file(path)


def test_without_sound_or_files_or_folder_it_says_so(tmp_path):
    path = write_csv(tmp_path / "a.csv", rows())

    with pytest.raises(TrackError, match="no sound beside it"):
        read_track_file(path)
    with pytest.raises(TrackError, match="no such folder"):
        read_track_files(tmp_path / "none")
    (tmp_path / "empty").mkdir()
    with pytest.raises(TrackError, match=r"no NAME\.csv"):
        read_track_files(tmp_path / "empty")
