"""How wrong a mouth looks that shows the recognised viseme in place of the spoken one.

A T in place of a K is a wrong frame that cannot be seen; everybody sees a rounded vowel in place of
a spread one. So frames are weighted by the distance of the mean faces of the two classes: gap,
width and protrusion of the lips, in mm, of the shipped face.
"""

from collections.abc import Mapping
from functools import cache

import numpy as np
from numpy.typing import NDArray

from lipservo_lab.baselines.baselines import read_baselines, viseme_centres
from lipsync.arrays import Array
from lipsync.face.model import open_model, read_face
from lipsync.phonemes import PHONEMES, VISEME_CLASSES


@cache
def visible_distances_mm() -> Array:
    """Return the distance of the lip shapes of each two viseme classes, in mm.

    A class without training data has the shape of the class that replaces it.

    Returns
    -------
    Array
        (n_visemes, n_visemes); 0 on the diagonal.
    """
    with open_model() as file:
        face = read_face(file)
        learned = read_baselines(file, face.n_components)
    faces = viseme_centres(learned.centres, learned.counts)
    markers_mm, layout = face.markers_mm(faces), face.layout
    width_mm = np.ptp(markers_mm[:, list(layout.lips), 0], axis=1)
    middle_mm = (markers_mm[:, layout.upper_lip] + markers_mm[:, layout.lower_lip]) / 2.0
    # As in `evaluation.motion.measures.lip_shapes_mm`, which this package must not import.
    shapes_mm = np.stack([face.lip_gaps_mm(markers_mm), width_mm, middle_mm[:, 2]], axis=1)
    by_class = shapes_mm[[PHONEMES.index(members[0]) for members in VISEME_CLASSES]]
    distances: Array = np.linalg.norm(by_class[:, None] - by_class[None], axis=2)
    distances.setflags(write=False)
    return distances


def visible_error_mm(confusion: NDArray[np.int64]) -> float:
    """Return how far, on average over frames, the shown lip shape is from the spoken one.

    Parameters
    ----------
    confusion : NDArray[np.int64]
        (n_visemes, n_visemes), rows are spoken classes.

    Returns
    -------
    float
        mm.
    """
    n_frames = int(confusion.sum())
    return float((confusion * visible_distances_mm()).sum()) / n_frames if n_frames else 0.0


def visible_error_table(confusion: NDArray[np.int64]) -> Mapping[str, Mapping[str, object]]:
    """Return for each spoken class its frames, its mean error, and the classes recognised instead.

    heard_as: share of the class's frames, and the mm that it adds to the class's mean, worst first.

    Parameters
    ----------
    confusion : NDArray[np.int64]
        (n_visemes, n_visemes), rows are spoken classes.

    Returns
    -------
    Mapping[str, Mapping[str, object]]
        By class, named by its phonemes; errors in mm.
    """
    table: dict[str, Mapping[str, object]] = {}
    for spoken, counts in enumerate(confusion):
        if not (n_frames := int(counts.sum())):
            continue
        shares = counts / n_frames
        errors_mm = shares * visible_distances_mm()[spoken]
        worst = [int(heard) for heard in np.argsort(-errors_mm, kind="stable") if counts[heard]]
        table[_name(spoken)] = {
            "frames": n_frames,
            "visible_error_mm": float(errors_mm.sum()),
            "heard_as": {
                _name(heard): {
                    "share": float(shares[heard]),
                    "visible_error_mm": float(errors_mm[heard]),
                }
                for heard in worst
            },
        }
    return table


def _name(viseme: int) -> str:
    return " ".join(VISEME_CLASSES[viseme])
