"""The warp of a photograph as bytes for a web page: the mesh and what moves it, without pixels.

A header and arrays, packed like those of a twin (`lipsync/twin/packed.py`). All lengths are in
pixels of the photograph, x right, y down, z to the viewer, so that a page needs neither the head
nor its pose.
"""

from lipservo.display.lip_contact import LipContact
from lipservo.display.mouth_inside import (
    DARK_MM,
    DARKNESS,
    LEAST_LIGHT,
    LIGHT_MM,
    PARTED_MM,
    SHADE,
    SHADOW_MM,
    MouthParts,
    SeenPart,
)
from lipservo.display.photo_face import PhotoFace
from lipservo.display.photo_warp import MOST, MOST_POSE_DEG, RIM_NEIGHBOURS, RINGS, PhotoWarp
from lipsync.face.model import FaceModel
from lipsync.twin.packed import Body


def pack_photo(photo: PhotoFace, face: FaceModel) -> bytes:
    """Return a photograph's mesh, the motions that move it, and the mouth's inside, as bytes.

    They are for a web page, read by lipservo/dashboard/static/show/photo_warp.js. face: the model
    whose rest is shown first.
    """
    warp, body = PhotoWarp(photo), Body()
    parts = MouthParts(photo, warp.own_px[warp.lips])
    height, width = photo.picture.shape[:2]
    per_mm = photo.px_per_mm
    header = {
        "size": [width, height],
        "components": photo.twin.components,
        "own": photo.own.tolist(),
        "rest": face.rest.tolist(),
        "axes": (photo.matrix / per_mm).tolist(),
        "pivot_px": photo.in_picture(photo.twin.pivot_mm).tolist(),
        "most": MOST,
        "most_pose_deg": MOST_POSE_DEG,
        "places": body.add(photo.in_picture(warp.places_mm), "<f4"),
        "targets": {
            name: body.add_scaled(moves @ photo.matrix.T, "<i2")
            for name, moves in warp.targets.items()
        },
        "own_px": body.add(warp.own_px, "<f4"),
        "rest_px": body.add(warp.mesh.rest_px, "<f4"),
        "triangles": body.add(warp.mesh.triangles, "<u2"),
        "first_skin": warp.mesh.skin.start,
        "first_eye": warp.eye_fans.start,
        "lips": warp.lips.tolist(),
        "rim": warp.rim.tolist(),
        "eyes": [eye.tolist() for eye in warp.eyes],
        "rings": [share for _, share in RINGS],
        "rim_neighbours": RIM_NEIGHBOURS,
        "contact": _contact_values(warp.contact),
        "layers": [_pack_part(part, body) for part in parts.layers],
        "hidden_px": parts.hidden_px.tolist(),
        "darkness": DARKNESS.tolist(),
        "least_light": LEAST_LIGHT,
        "light_px": [DARK_MM * per_mm, LIGHT_MM * per_mm],
        "shade": SHADE,
        "parted_px": PARTED_MM * per_mm,
        "shadow_px": SHADOW_MM * per_mm,
    }
    return body.behind(header)


def _contact_values(contact: LipContact) -> dict[str, object]:
    """Return the arrays of a lip contact as JSON values, from which a web page computes the same.

    `felt` has rows, columns and values of two sparse matrices.
    """
    felt = [each.tocoo() for each in contact.felt]
    return {
        "upper": contact.upper.tolist(),
        "lower": contact.lower.tolist(),
        "down": contact.down.tolist(),
        "excess_px": contact.excess_px.tolist(),
        "least_px": contact.least_px.tolist(),
        "own_gap_mm": contact.own_gap_mm,
        "gap_at_zero_mm": contact.gaps.at_zero.tolist(),
        "gap_each_mm": contact.gaps.each.tolist(),
        "felt": [[each.row.tolist(), each.col.tolist(), each.data.tolist()] for each in felt],
    }


def _pack_part(part: SeenPart, body: Body) -> dict[str, object]:
    """Add the arrays of a part of the mouth's inside to `body`; return their header entries."""
    return {
        "places": body.add(part.places_px, "<f4"),
        "colours": body.add(part.colours.round().clip(0, 255), "u1"),
        "triangles": body.add(part.triangles, "<u2"),
        "moves_px": {name: way.tolist() for name, way in part.moves_px.items()},
        "raised_by": part.raised_by,
    }
