"""Which tracker a user gets: the landmarker file that is given, else mediapipe's own."""

from importlib.util import find_spec
from pathlib import Path

from lipsync.video.tracking.face_tracker import FaceTracker, TrackerError


def open_tracker(landmarker: Path | None) -> FaceTracker:
    """A tracker. Raises TrackerError, MissingExtraError where there is none."""
    if landmarker is not None:
        from lipsync.video.tracking.litert_tracker import LitertTracker

        return LitertTracker(landmarker)
    if find_spec("mediapipe") is None:
        raise TrackerError(
            "no face tracker: give --landmarker FILE, a face_landmarker.task (docs/own-face.md "
            "says how to get one), or, up to Python 3.12, `pip install 'lipservo[video]'`"
        )
    from lipsync.video.tracking.mediapipe_tracker import MediapipeTracker

    return MediapipeTracker()
