"""The page for an audience: the mouth from near, and the user's own robot by its encoders."""

import math

import pytest

#: A real browser; CI runs it once.
pytestmark = pytest.mark.slow

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
    page.wait_for_function(expression, timeout=20_000)


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
