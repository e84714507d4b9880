"""`lipservo learn import-video` as it is typed: what it prints, writes, and refuses."""

import json

import pytest

pytest.importorskip("av", reason="video needs PyAV, the extra `video`")
pytest.importorskip("matplotlib", reason="the picture sheet needs the extra `plots`")

from pixel_video import PixelTracker
from talking_pixels import write_clip, write_pictures

from lipservo import command_line
from lipsync.video import face_tracker as trackers


@pytest.fixture(autouse=True)
def _pixels(monkeypatch):
    monkeypatch.setattr(trackers, "open_tracker", lambda _landmarker: PixelTracker())


def lipservo(capsys, *arguments):
    """Exit status, stdout, stderr."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", ["lipservo", *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            command_line.main()
    return (end.value.code, *capsys.readouterr())


@pytest.mark.slow
def test_a_folder_becomes_a_corpus_with_a_picture_sheet(tmp_path, capsys):
    clips, corpus = tmp_path / "clips", tmp_path / "corpus"
    clips.mkdir()
    write_clip(clips / "good.mkv")
    write_pictures(clips / "nobody.mkv")
    status, out, err = lipservo(capsys, "learn", "import-video", clips, "-o", corpus, "-q")
    assert status == 0
    assert "1 clips, 0.1 minutes at 25 pictures a second, 1 left out; 1 without text" in out
    assert "left out: nobody: no face in any picture" in err
    assert (corpus / "faces.png").read_bytes().startswith(b"\x89PNG")
    told = json.loads((corpus / "import.json").read_text())
    assert (told["used"], told["left_out"], told["recognised"]) == (1, 1, 1)


def test_where_nothing_is_usable_the_status_is_not_0_and_nothing_is_written(tmp_path, capsys):
    clip = write_pictures(tmp_path / "nobody.mkv")
    status, _, err = lipservo(
        capsys, "learn", "import-video", clip, "-o", tmp_path / "corpus", "-q"
    )
    assert status == 1
    assert "no clip can be used: nobody: no face in any picture" in err
    assert [path.name for path in tmp_path.iterdir()] == ["nobody.mkv"]


@pytest.mark.slow
def test_bench_motion_compares_our_mouth_with_the_filmed_one(tmp_path, capsys):
    write_clip(tmp_path / "good.mkv")
    write_clip(tmp_path / "late.mkv", sound_late_s=0.2)
    write_pictures(tmp_path / "nobody.mkv")
    status, out, _ = lipservo(capsys, "bench", "motion", "--video", tmp_path, "--json", "-q")
    assert status == 0
    answer = json.loads(out)
    good, late, nobody = answer["clips"]
    assert good["gap_r"] > 0.6 > good["loudness_r"]
    assert abs(good["best_shift_ms"]) <= 30
    assert late["best_shift_ms"] == pytest.approx(200, abs=30)
    assert late["gap_r"] < 0.5 < late["gap_r_at_best"]
    assert nobody["gap_r"] is None
    assert nobody["left_out"].startswith("no face")
    # Clips count by their pictures of speech: between the two.
    assert late["gap_r"] < answer["gap_r"] < good["gap_r"]
