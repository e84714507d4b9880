"""The page for an audience: a photograph that speaks, the mouth from near, the user's own robot."""

import gzip
import io
import json
import math

import numpy as np
import pytest
from places import ROOT

from lipservo.display.photo_face import HAND_POINTS
from lipservo.display.photo_file import read_landmarks
from lipservo.display.photo_warp import PhotoWarp
from lipservo.display.shipped_faces import TWIN_SIZE, twin_face, twin_landmarks
from lipsync.face.frame import Expression, Frame
from lipsync.face.model import load_face

#: A real browser; CI runs it once.
pytestmark = pytest.mark.slow

FACE = load_face()
URDF = """<robot name="head">
  <link name="skull"><visual><geometry><sphere radius="0.09"/></geometry></visual></link>
  <link name="chin"><visual><origin xyz="0.05 0 -0.04"/>
    <geometry><box size="0.06 0.08 0.02"/></geometry></visual></link>
  <link name="eye"><visual><geometry><mesh filename="package://robot/Eye.STL"/></geometry></visual></link>
  <joint name="Jaw" type="revolute"><parent link="skull"/><child link="chin"/>
    <origin xyz="0 0 -0.03"/><axis xyz="0 1 0"/></joint>
  <joint name="gaze" type="fixed"><parent link="skull"/><child link="eye"/></joint>
</robot>"""


def settled(page, expression):
    page.wait_for_function(expression, timeout=120_000)


def glb(*names):
    trimesh = pytest.importorskip("trimesh", reason="models of robots are made with trimesh")
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.creation.icosphere(radius=0.09), node_name="skull")
    for name in names:
        box = trimesh.creation.box((0.06, 0.02, 0.08))
        scene.add_geometry(
            box,
            node_name=name,
            transform=trimesh.transformations.translation_matrix((0, -0.08, 0.03)),
        )
    return scene.export(file_type="glb")


def show(page, *files):
    page.wait_for_function("window.ownRobot && document.querySelector('face-model input')")
    page.set_input_files("face-model input", [
        {"name": name, "mimeType": "application/octet-stream", "buffer": content}
        for name, content in files
    ])  # fmt: skip


def test_a_glb_moves_by_the_encoders(opened, face):
    face.encoders_deg |= {"jaw": 12.0}
    page = opened("/show")
    show(page, ("robot.glb", glb("JAW")))
    settled(page, "window.ownRobot.shown?.jaw === 12")
    turned = page.evaluate("2 * Math.asin(ownRobot.model.root.getObjectByName('JAW').quaternion.x)")
    assert math.degrees(turned) == pytest.approx(12.0, abs=0.01)
    assert "1 joint moves" in page.inner_text("face-model .told")


def test_a_urdf_moves_and_says_which_meshes_it_lacks(opened, face):
    face.encoders_deg |= {"jaw": -7.0}
    page = opened("/show")
    show(page, ("robot.urdf", URDF.encode()))
    settled(page, "window.ownRobot.shown?.jaw === -7")
    told = page.inner_text("face-model .told")
    assert "eye.stl" in told
    assert page.evaluate("ownRobot.model.names").count("Jaw") == 1


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("robot.glb", glb, "No part of this model is named as a servo"),
        ("robot.glb", b"glTF nonsense", "The model cannot be shown"),
        ("robot.urdf", b"<robot", "it is no URDF"),
        ("robot.fbx", b"", "none of these files"),
    ],
)
def test_what_is_no_model_of_this_face_is_said_in_one_line(opened, name, content, says):
    page = opened("/show")
    show(page, (name, content() if callable(content) else content))
    settled(page, f"document.querySelector('face-model .told').textContent.includes({says!r})")


def test_the_mouth_is_seen_from_near(opened):
    page = opened("/show")
    settled(page, "window.twin?.ready")
    page.check("face-close-up input")
    settled(page, "window.twin.isNear === true")
    page.reload()
    settled(page, "window.twin?.ready && window.twin.isNear")
    page.uncheck("face-close-up input")
    settled(page, "window.twin.isNear === false")


def show_photograph(page, *files):
    settled(page, "window.photograph && document.querySelector('face-photo input')")
    page.set_input_files("face-photo input", [
        {"name": name, "mimeType": "application/octet-stream", "buffer": content}
        for name, content in files
    ])  # fmt: skip


def picture(size=(640, 480), kind="PNG", **how):
    image = pytest.importorskip("PIL.Image", reason="pictures are written with Pillow")
    mode = how.pop("mode", "RGB")
    written = io.BytesIO()
    image.new(mode, size, 128).save(written, kind, **how)
    return written.getvalue()


def hand_points(share=1.0):
    known = twin_landmarks()
    at = {name: (share * known[n][:2]).tolist() for name, n in HAND_POINTS.items()}
    return json.dumps({"points_px": at}).encode()


def test_the_photograph_moves_in_the_page_as_in_films(opened):
    page = opened("/show")
    page.click("[data-show=photo]")
    settled(page, "window.photograph?.view?.drawn > 0")
    warp = PhotoWarp(twin_face(FACE, TWIN_SIZE))
    random = np.random.default_rng(0)
    for coefficients in random.multivariate_normal(FACE.rest, 2 * FACE.covariance, 6):
        turned = {"neck_yaw_deg": 8.0, "neck_pitch_deg": -5.0, "brow": 0.4, "lid_left": 0.6}
        wanted, _ = warp.moved(Frame(0.0, coefficients, Expression(**turned)))
        given = {"coefficients": coefficients.tolist(), "expression": turned}
        found = page.evaluate(
            "async (frame) => {"
            "const { moved } = await import('/static/show/photo_warp.js');"
            "return [...moved(photograph.warp, frame).px]; }",
            given,
        )
        away_px = np.abs(np.reshape(found, (-1, 2)) - wanted).max(axis=1)
        # Where triangles would turn over, a thousandth of a pixel decides which go together.
        assert np.percentile(away_px, 98) < 0.01
        assert away_px.max() < 1.5


def test_the_photograph_opens_its_mouth_and_shuts_it(opened):
    page = opened("/show")
    page.click("[data-show=photo]")
    settled(page, "window.photograph?.view?.drawn > 0")
    page.evaluate("photograph.undo()")
    wide = FACE.rest.copy()
    wide[0] -= 2.6 * float(np.sqrt(FACE.covariance[0, 0]))
    gaps = [
        page.evaluate(
            "c => { photograph.view.show({ coefficients: c }); return photograph.view.gapPx }",
            each.tolist(),
        )
        for each in (FACE.rest, wide, FACE.rest)
    ]
    assert gaps[0] < 1.0 < 15.0 < gaps[1]
    assert gaps[2] == gaps[0]


def test_points_of_an_own_photograph_are_set_by_hand_and_kept(opened, tmp_path):
    page = opened("/show")
    show_photograph(page, ("me.png", picture()))
    settled(page, "document.querySelector('face-points g')")
    dot = page.locator("[data-point=chin]")
    dot.focus()
    before = page.evaluate("document.querySelector('face-points').points.nose_tip[1]")
    page.keyboard.press("Shift+ArrowDown")
    after = page.evaluate("document.querySelector('face-points').points")
    assert after["nose_tip"][1] == pytest.approx(before + 10, abs=0.01)  # the others follow
    page.click("face-photo .done")
    settled(page, "window.photograph?.view?.drawn > 0")
    with page.expect_download() as saved:
        page.click("face-photo .keep")
    saved.value.save_as(tmp_path / "me.json")
    read = read_landmarks(tmp_path / "me.json", 1.0)
    np.testing.assert_allclose(read[HAND_POINTS["chin"]], after["chin"], atol=0.06)
    page.reload()
    show_photograph(page, ("me.png", picture()))
    settled(page, "window.photograph?.view?.drawn > 0")


@pytest.mark.parametrize(
    "written",
    [
        picture,
        lambda: picture(kind="JPEG", mode="L"),
        lambda: picture(kind="JPEG", mode="CMYK"),
        lambda: picture(mode="RGBA"),
        lambda: picture((8000, 8000)),
    ],
    ids=["plain", "grey", "CMYK", "alpha", "8000 x 8000"],
)
def test_photographs_of_all_kinds_are_shown(opened, written):
    page = opened("/show")
    show_photograph(page, ("me.img", written()), ("me.json", hand_points(0.6)))
    settled(page, "window.photograph?.view?.drawn > 0 && photograph.name === 'me.img'")


@pytest.mark.parametrize(
    ("name", "content", "points", "says"),
    [
        ("me.png", b"no picture", b"", "cannot be read as a picture"),
        ("me.png", lambda: picture((40, 40)), b"", "40 x 40 pixels"),
        ("me.png", picture, b"{", "no points of a face"),
        ("me.png", picture, lambda: hand_points(0.1), "pixels wide"),
        ("me.png", picture, b'{"points_px": {"chin": [5, 5]}}', "are missing"),
    ],
)
def test_what_is_no_photograph_of_a_face_is_said_in_one_line(opened, name, content, points, says):
    page = opened("/show")
    files = [(name, content() if callable(content) else content)]
    if points:
        files.append(("me.json", points() if callable(points) else points))
    show_photograph(page, *files)
    settled(page, f"document.querySelector('face-photo .told').textContent.includes({says!r})")


def test_a_trace_is_scrubbed_back_and_forth_in_place_of_the_live_face(opened):
    page = opened("/show")
    settled(page, "window.twin?.ready && window.tracePlayer")
    page.set_input_files("face-trace input[type=file]", ROOT / "tests/data/traces/clip.jsonl.gz")
    settled(page, "window.tracePlayer.trace")
    with gzip.open(ROOT / "tests/data/traces/clip.jsonl.gz", "rt") as lines:
        ticks = [each for each in map(json.loads, lines) if "coefficients" in each]
    for n in (40, 12):
        page.evaluate(f"tracePlayer.at({n})")
        wanted = ticks[n]["coefficients"]
        settled(page, f"Math.abs(twin.pose.targets.c0 - {wanted[0]}) < 1e-6")
    page.click("face-trace .live")
    settled(page, "dashboard.held === null && twin.last === dashboard.frame")
    assert "recorded" not in page.inner_text("face-trace .told")


def test_what_is_no_trace_is_said_in_one_line(opened):
    page = opened("/show")
    settled(page, "window.tracePlayer")
    page.set_input_files(
        "face-trace input[type=file]",
        {"name": "talk.jsonl", "mimeType": "text/plain", "buffer": b"{}"},
    )
    told = "document.querySelector('face-trace .told').textContent"
    settled(page, f"{told}.includes('no lipservo trace')")


def open_trace(page, name, content):
    page.set_input_files(
        "face-trace input[type=file]",
        {"name": name, "mimeType": "text/plain", "buffer": content},
    )


def test_a_trace_of_an_hour_is_shown_and_a_file_that_is_none_gives_the_live_face_back(opened):
    head = {"lipservo_trace": 1, "servos": ["jaw"]}
    tick = {"phoneme": "AA", "coefficients": FACE.rest.tolist(), "sent_deg": [1.0]}
    short = "\n".join(map(json.dumps, [head, *({"sound_s": n / 50.0, **tick} for n in range(2))]))
    page = opened("/show")
    settled(page, "window.twin?.ready && window.tracePlayer")
    open_trace(page, "hour.jsonl", short.encode())
    told = "document.querySelector('face-trace .told').textContent"
    settled(page, f"{told}.includes('recorded, not the live face')")
    settled(page, "dashboard.held !== null")
    page.evaluate(
        """() => {
          for (const [name, values] of Object.entries(tracePlayer.trace)) {
            if (name !== 'servos') tracePlayer.trace[name] = Array(140_000).fill(values[0]);
          }
          tracePlayer.trace.timesS = tracePlayer.trace.timesS.map((_, n) => n / 50);
          tracePlayer.at(139_999);
        }"""
    )
    open_trace(page, "talk.jsonl", b"{}")
    settled(page, f"{told}.includes('no lipservo trace')")

    assert page.evaluate("dashboard.held === null")


def test_a_second_photograph_has_no_points_of_the_first(opened):
    page = opened("/show")
    show_photograph(page, ("a.png", picture()), ("a.json", hand_points(0.6)))
    settled(page, "photograph.name === 'a.png' && photograph.view?.drawn > 0 && photograph.points")
    page.locator("face-photo .keep").wait_for()
    show_photograph(page, ("b.png", picture((700, 500))))
    settled(page, "photograph.name === 'b.png' && document.querySelector('face-points g')")

    assert page.evaluate("photograph.points") is None
    assert page.locator("face-photo .keep").is_hidden()
