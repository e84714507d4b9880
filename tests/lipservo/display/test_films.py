"""Films: sound on its pictures, nothing half-written, and every kind of photograph."""

import errno
import json

import numpy as np
import pytest
import soundfile

pytest.importorskip("av", reason="films need PyAV, the extra `film`")
pytest.importorskip("cv2", reason="films need OpenCV, the extra `film`")

from PIL import Image
from places import ROOT
from speech import CLIP_LABELS_PATH, CLIP_PATH
from written_performance import written_performance

from lipservo.display import film as film_module
from lipservo.display.film import FilmError, check_film, is_film, write_film
from lipservo.display.filmed_faces import FilmRequest, make_film
from lipservo.display.filmed_motion import SpeechRequest, filmed
from lipservo.display.photo_face import PhotoError
from lipservo.display.photo_file import read_landmarks, read_photo, tracked
from lipservo.display.robot_display import RobotDisplay
from lipservo.display.shipped_faces import twin_landmarks
from lipservo.runtime.motion_options import ChosenMotion, MotionOptions
from lipservo.runtime.servos.assembly import assemble_face
from lipsync.errors import UserError
from lipsync.face.frame import Expression, Frame
from lipsync.motion.finishing import Style
from lipsync.output_file import OutputError
from lipsync.phoneme_files.label_file import LabelFile
from lipsync.phoneme_files.reader import read_phonemes
from lipsync.video.video_file import video_pictures, video_sound

SIZE = (160, 128)


def quiet(*_):
    """No progress."""


def pictures(n):
    for at in range(n):
        yield np.full((SIZE[1], SIZE[0], 3), 255 if at in (5, 20) else 0, dtype=np.uint8)


def clicks(path, rate_hz=44_100):
    samples = np.zeros(rate_hz, dtype=np.float32)
    for at in (5, 20):
        samples[at * rate_hz // 25 :][:60] = 0.9 * np.hanning(60)
    soundfile.write(path, samples, rate_hz)
    return path


@pytest.mark.parametrize("ending", [".mp4", ".mkv"])
def test_a_click_is_heard_when_its_picture_is_seen(tmp_path, ending):
    out = tmp_path / f"film{ending}"
    assert write_film(pictures(25), SIZE, clicks(tmp_path / "clicks.wav"), out) == 25
    flashes = [time_s for time_s, picture in video_pictures(out) if picture.mean() > 128]
    assert flashes == pytest.approx([0.2, 0.8], abs=1e-3)
    sound = video_sound(out)
    loud = np.flatnonzero(np.abs(sound.samples) > 0.3) / 16_000 + sound.begins_s
    for flash in flashes:
        assert np.abs(loud - flash).min() < 0.005
    assert is_film(out.read_bytes()[:64])


def test_a_disk_that_is_full_in_mid_film_leaves_nothing_and_says_so_in_a_line(
    tmp_path, monkeypatch
):
    import av

    class FullStream:
        def __init__(self, stream):
            self._stream = stream
            self._n = 0

        def __getattr__(self, name):
            return getattr(self._stream, name)

        def __setattr__(self, name, value):
            if name.startswith("_"):
                object.__setattr__(self, name, value)
            else:
                setattr(self._stream, name, value)

        def encode(self, shot):
            self._n += 1
            if self._n > 3:
                raise av.error.OSError(errno.ENOSPC, "No space left on device")
            return self._stream.encode(shot)

    class Full:
        def __init__(self, file):
            self._file = file

        def __enter__(self):
            return self

        def __exit__(self, *about):
            return self._file.__exit__(*about)

        def add_stream(self, *given, **options):
            return FullStream(self._file.add_stream(*given, **options))

        def mux(self, packets):
            self._file.mux(packets)

    opened = av.open
    monkeypatch.setattr(film_module, "open_film", lambda *given, **how: Full(opened(*given, **how)))
    out = tmp_path / "film.mp4"
    with pytest.raises(OutputError, match=r"film\.mp4: cannot be written: No space left") as told:
        write_film(pictures(25), SIZE, None, out)
    assert "\n" not in str(told.value)
    assert list(tmp_path.iterdir()) == []


def test_whoever_is_interrupted_in_mid_film_keeps_the_film_that_was_there(tmp_path):
    out = tmp_path / "film.mp4"
    write_film(pictures(5), SIZE, None, out)
    before = out.read_bytes()

    def broken():
        yield from pictures(3)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_film(broken(), SIZE, None, out)
    assert out.read_bytes() == before
    assert list(tmp_path.iterdir()) == [out]


def test_a_name_that_says_no_kind_of_film_is_refused(tmp_path):
    with pytest.raises(FilmError, match="a film's name must end in"):
        check_film(tmp_path / "film.gif")


@pytest.mark.parametrize("face", ["twin", "robot", "beside"])
def test_a_performance_is_filmed_with_its_sound(tmp_path, face):
    line = written_performance(tmp_path / "line.perf", duration_s=0.4)
    out = tmp_path / "film.mp4"
    asked = FilmRequest(str(line), out, face, SIZE, 25, "face_sim", None)
    done = make_film(asked, ChosenMotion(), quiet)
    assert done["pictures"] == 10
    seen = list(video_pictures(out))
    assert seen[0][1].shape == (SIZE[1], SIZE[0] * (2 if face == "beside" else 1), 3)
    assert len(video_sound(out).samples) == pytest.approx(0.4 * 16_000, abs=900)


def test_the_robot_is_drawn_as_its_servos_stand():
    robot = RobotDisplay(assemble_face("face_sim", None), (320, 240), 0.04)
    face = assemble_face("face_sim", None)
    names = list(face.settings.servos)
    closed = robot.draw_angles(names, np.zeros(len(names)))
    open_ = robot.draw_angles(names, np.array([15.0 * (name == "jaw") for name in names]))
    dark = [(each.mean(axis=2) < 60).sum() for each in (closed, open_)]
    assert dark[1] > dark[0] + 200
    nods = RobotDisplay(assemble_face("face_head", None), (320, 240), 0.04)
    rest = assemble_face("face_head", None).model.rest
    for _ in range(20):
        nod = nods.draw(Frame(0.0, rest, Expression(neck_pitch_deg=8.0)))
    assert (nod != nods.draw(Frame(0.0, rest))).any()


def a_picture(size=(400, 300)):
    across = np.linspace(0, 255, size[0])
    down = np.linspace(0, 255, size[1])
    grey = np.add.outer(down, across) / 2
    return Image.fromarray(np.stack([grey, grey * 0.8, grey * 0.6], axis=2).astype(np.uint8))


@pytest.mark.parametrize("mode", ["RGB", "L", "CMYK", "RGBA", "LA", "P", "1", "I;16"])
def test_pictures_of_any_mode_come_in_red_green_and_blue(tmp_path, mode):
    path = tmp_path / ("a.jpg" if mode == "CMYK" else "a.png")
    image = a_picture()
    if mode == "I;16":
        image = Image.fromarray(np.asarray(image.convert("L")).astype(np.uint16) * 257)
    else:
        image = image.convert(mode)
    image.save(path)
    picture, share = read_photo(path)
    assert picture.shape == (300, 400, 3)
    assert picture.dtype == np.uint8
    assert share == 1.0
    # Bright at the lower right in every one of them.
    assert picture[-40:, -40:].mean() > picture[:40, :40].mean() + 60


def test_a_picture_held_sideways_comes_upright(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 6  # a quarter turn to the left was needed to take it
    a_picture().save(tmp_path / "a.jpg", exif=exif)
    picture, share = read_photo(tmp_path / "a.jpg")
    assert picture.shape == (400, 300, 3)
    assert share == 1.0
    assert picture[-40:, :40].mean() > picture[:40, -40:].mean() + 60


@pytest.mark.parametrize("value", [0, 9, 274, 65_535])
def test_an_orientation_that_no_standard_has_turns_nothing(tmp_path, value):
    exif = Image.Exif()
    exif[0x0112] = value
    a_picture().save(tmp_path / "a.jpg", exif=exif)
    a_picture().save(tmp_path / "plain.jpg")
    picture, share = read_photo(tmp_path / "a.jpg")
    assert share == 1.0
    assert picture.shape == read_photo(tmp_path / "plain.jpg")[0].shape


@pytest.mark.parametrize(
    ("size", "says"), [((40, 40), "both sides need 64"), ((20_000, 8_000), "120 million at most")]
)
def test_pictures_far_too_small_or_large_are_refused_before_they_are_unpacked(tmp_path, size, says):
    path = tmp_path / "a.png"
    Image.new("1", size).save(path)
    with pytest.raises(PhotoError, match=says):
        read_photo(path)


def test_a_picture_of_8000_pixels_is_brought_to_what_a_film_needs(tmp_path):
    Image.new("L", (8_000, 8_000), 90).save(tmp_path / "a.jpg")
    picture, share = read_photo(tmp_path / "a.jpg")
    assert max(picture.shape) <= 1920
    assert share == pytest.approx(picture.shape[1] / 8_000)


def test_what_is_no_picture_is_refused_in_one_line(tmp_path):
    (tmp_path / "a.jpg").write_bytes(b"\xff\xd8 not a picture")
    with pytest.raises(PhotoError, match="cannot be read as a picture"):
        read_photo(tmp_path / "a.jpg")


class Tracker:
    name = "by hand"

    def __init__(self, n):
        self._n = n

    def faces(self, _picture):
        return (np.ones((478, 3)),) * self._n


@pytest.mark.parametrize(("n", "says"), [(0, "no face is found"), (2, "2 faces are found")])
def test_a_picture_without_one_face_is_refused(n, says):
    with pytest.raises(PhotoError, match=says):
        tracked(np.zeros((9, 9, 3), np.uint8), Tracker(n), "a.jpg")


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("{", "no points of a face"),
        ('{"points_px": {"nose": [1, 2]}}', "no points of a face"),
        ('{"points_px": {"nose_tip": [1]}}', "must be \\[x, y\\]"),
        ('{"points_px": {"nose_tip": [1, 2]}}', "are missing: right_eye_outer"),
    ],
)
def test_landmarks_that_are_none_are_refused_with_what_is_missing(tmp_path, content, says):
    path = tmp_path / "a.json"
    path.write_text(content)
    with pytest.raises(PhotoError, match=says):
        read_landmarks(path, 1.0)


def test_a_photograph_is_filmed_by_points_set_by_hand(tmp_path):
    import json
    import shutil

    from places import ROOT

    from lipservo.display.photo_face import HAND_POINTS

    shutil.copy(ROOT / "lipservo" / "display" / "twin.jpg", tmp_path / "me.jpg")
    known = twin_landmarks()
    points = {name: known[number][:2].tolist() for name, number in HAND_POINTS.items()}
    (tmp_path / "me.json").write_text(json.dumps({"points_px": points}))
    line = written_performance(tmp_path / "line.perf", duration_s=0.2)
    asked = FilmRequest(
        str(line), tmp_path / "film.mp4", str(tmp_path / "me.jpg"), SIZE, 25, "face_sim", None,
        landmarks=tmp_path / "me.json",
    )  # fmt: skip
    assert make_film(asked, ChosenMotion(), quiet)["pictures"] == 5


def test_a_sound_that_is_not_there_is_no_text_to_be_spoken(tmp_path):
    asked = FilmRequest("hello.wav", tmp_path / "film.mp4", "robot", SIZE, 25, "face_sim", None)
    with pytest.raises(UserError, match=r"hello\.wav: no such file"):
        make_film(asked, ChosenMotion(), quiet)


@pytest.fixture
def spoken_face(tmp_path):
    """A face with a voice of the user's own that notes its language, and speaks a recording."""
    clip = tmp_path / "clip.wav"
    samples, rate_hz = soundfile.read(CLIP_PATH)
    soundfile.write(clip, samples, rate_hz)
    own = tmp_path / "voice.sh"
    own.write_text(f'echo "$2" >> {tmp_path}/language\ncp {clip} "$1"\n')
    yaml = tmp_path / "face.yaml"
    shipped = (ROOT / "config" / "face_sim.yaml").read_text()
    sound = {"synthesizer": "command", "voice": f"sh {own} {{wav}} {{language}}", "language": "de"}
    yaml.write_text(f"{shipped}\nsound: {json.dumps(sound)}\n")
    return str(yaml)


def test_a_text_is_spoken_in_the_language_of_the_face(spoken_face, tmp_path):
    request = SpeechRequest(MotionOptions(), spoken_face, None)
    with filmed("Guten Morgen.", request, 25):
        assert (tmp_path / "language").read_text().strip() == "de"


def test_a_text_is_filmed_for_a_face_that_hears_one_channel_of_its_sounds(spoken_face):
    """A voice has one channel."""
    request = SpeechRequest(MotionOptions(), spoken_face, None, channel="right")
    with filmed("Guten Morgen.", request, 25) as motion:
        assert len(motion.frames) > 0


def test_both_faces_of_a_text_speak_the_same_utterance(spoken_face, tmp_path):
    """A voice may speak a text otherwise each time."""
    film = tmp_path / "film.mp4"
    asked = FilmRequest(
        "Guten Morgen.", film, "twin", SIZE, 5, spoken_face, None, beside="priority"
    )
    make_film(asked, ChosenMotion(), quiet)
    assert (tmp_path / "language").read_text().split() == ["de"]


def test_a_head_that_moves_tucks_its_lip_for_f_and_v_and_not_for_m_and_shows_its_tongue_for_th():
    labels = LabelFile(CLIP_LABELS_PATH)
    on_stage = MotionOptions(style=Style(stage=1.0))
    request = SpeechRequest(on_stage, "face_sim", None, script=labels, head="face_head")
    with filmed(str(CLIP_PATH), request, 50) as motion:
        tucks = np.array([frame.expression.lip_tuck for frame in motion.frames])
        tongues = np.array([frame.expression.tongue_dental for frame in motion.frames])
        assert motion.frames[0].expression.brow is not None

    for event in read_phonemes(CLIP_LABELS_PATH):
        around = tucks[round(50 * event.start_s) : round(50 * event.end_s) + 1]
        if event.phoneme in ("F", "V"):
            assert around.max() > 0.45, event  # less where a B or M follows at once
        elif event.phoneme == "M":
            assert around.min() == 0.0, event
        elif event.phoneme in ("TH", "DH"):
            assert tongues[round(50 * event.start_s) : round(50 * event.end_s) + 1].max() > 0.5, (
                event
            )
