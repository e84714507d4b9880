"""`lipservo learn import-scans` as it is typed: what it prints, writes, and refuses."""

import json
import re

import numpy as np
import pytest
import soundfile

pytest.importorskip("trimesh", reason="scans need the extra `scans`")
pytest.importorskip("matplotlib", reason="the picture sheet needs the extra `plots`")

import trimesh
from lipservo_lab.bench.scan_figures import known_scans
from lipservo_lab.corpus.grid import read_grid
from lipservo_lab.scans.head_alignment import shipped_template
from small_corpus import text_grid

from lipservo import command_line
from lipsync.face.model import load_face
from lipsync.markers import find_layout
from lipsync.twin.head_surface import load_mean_face

TEMPLATE = shipped_template()
NOISE = np.random.default_rng(0)
PHONES = [("SIL", 0.2), ("AA", 0.2), ("SIL", 0.2)]


def lipservo(capsys, *arguments):
    """Exit status, stdout, stderr."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", ["lipservo", *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            command_line.main()
    return (end.value.code, *capsys.readouterr())


def write_scan(path, points, triangles=TEMPLATE.triangles):
    path.parent.mkdir(parents=True, exist_ok=True)
    trimesh.Trimesh(points, triangles, process=False).export(path)


def write_folder(folder, points=TEMPLATE.vertices_mm, n=3):
    """One take of n scans at 5 a second, with its sound and labels."""
    for number in range(n):
        write_scan(folder / "take" / f"{number}.ply", points)
    soundfile.write(folder / "take.wav", NOISE.normal(0.0, 0.1, n * 3200), 16_000)
    (folder / "take.TextGrid").write_text(text_grid(PHONES))
    return folder


def refused(capsys, tmp_path, *arguments):
    """The one line that says why; nothing is left behind."""
    before = sorted(tmp_path.rglob("*"))
    status, out, err = lipservo(capsys, "learn", "import-scans", *arguments, "--quiet")
    assert status != 0
    assert out == ""
    assert sorted(tmp_path.rglob("*")) == before
    assert len(err.strip().splitlines()) == 1
    return err


@pytest.mark.parametrize(
    ("points", "told"),
    [
        (TEMPLATE.vertices_mm / 1000.0, "metres; give --unit m"),
        (TEMPLATE.vertices_mm / 25.4, "inches; give --unit in"),
        (TEMPLATE.vertices_mm * (-1.0, 1.0, 1.0), "mirrored.*--axes=-x,y,z"),
        (TEMPLATE.vertices_mm * (-1.0, -1.0, 1.0), "upside down.*--axes=-x,-y,z"),
    ],
)
def test_scans_of_other_units_or_axes_are_told_with_the_option_to_give(
    tmp_path, capsys, points, told
):
    folder = write_folder(tmp_path / "scans", points)

    err = refused(capsys, tmp_path, folder, "-o", tmp_path / "c", "--rate-hz", 5)

    assert re.search(told, err)


def test_what_is_wrong_beside_the_scans_is_told(tmp_path, capsys):
    folder = write_folder(tmp_path / "scans")
    corpus = tmp_path / "c"

    assert "--rate-hz 5" in refused(capsys, tmp_path, folder, "-o", corpus)
    (folder / "take.markers.csv").write_text("scan,name,x,y,z\n0,left_ear,1,2,3\n")
    told = refused(capsys, tmp_path, folder, "-o", corpus, "--rate-hz", 5)
    assert "no point 'left_ear'" in told
    (folder / "take.markers.csv").write_text("scan,name,x,y,z\n9,chin_18,1,2,3\n")
    assert "has no scan '9'" in refused(capsys, tmp_path, folder, "-o", tmp_path / "m.npz")
    (folder / "take.markers.csv").unlink()
    (folder / "take.wav").unlink()
    assert "no sound take.wav" in refused(capsys, tmp_path, folder, "-o", corpus, "--rate-hz", 5)


def test_a_folder_that_is_there_is_not_written_over(tmp_path, capsys):
    folder = write_folder(tmp_path / "scans")

    assert "exists already" in refused(capsys, tmp_path, folder, "-o", folder)


@pytest.mark.slow
def test_unregistered_scans_become_a_corpus_and_lost_ones_are_bridged(tmp_path, capsys):
    folder, corpus = tmp_path / "scans", tmp_path / "c"
    n = 5
    for number, known in enumerate(known_scans(load_face(), load_mean_face(), n, seed=3)):
        cloud = number == 2  # without triangles
        made = trimesh.PointCloud(known.points_mm) if cloud else None
        if made is None:
            write_scan(folder / "take" / f"f{number}.obj", known.points_mm, known.triangles)
        else:
            made.export(folder / "take" / f"f{number}.ply")
    (folder / "take" / "f3.obj").write_text("v 1 2\n")
    soundfile.write(folder / "take.wav", NOISE.normal(0.0, 0.1, n * 1600), 16_000)
    (folder / "take.TextGrid").write_text(text_grid([("SIL", 0.2), ("AA", 0.1), ("SIL", 0.2)]))

    status, out, err = lipservo(
        capsys, "learn", "import-scans", folder, "-o", corpus, "--rate-hz", 10, "--json", "--quiet"
    )

    assert status == 0, err
    told = json.loads(out)
    assert (told["used_scans"], told["left_out_scans"]) == (4, 1)
    assert told["takes"][0]["notes"] == ["1 scans bridged"]
    assert [s["left_out"] is None for s in told["scans"]] == [True, True, True, False, True]
    assert told["error_mm"] < 0.3
    assert (corpus / "scans.png").read_bytes().startswith(b"\x89PNG")
    sparse = read_grid(corpus)
    dense = read_grid(corpus, find_layout(str(corpus / "layout.json")))
    assert sparse.utterances[0].markers_mm.shape == (n, 47, 3)
    assert dense.utterances[0].markers_mm.shape == (n, len(TEMPLATE.landmarks), 3)
    gaps = np.linalg.norm(sparse.layout.gap_vectors_mm(sparse.utterances[0].markers_mm), axis=1)
    assert np.ptp(gaps) > 1.0
