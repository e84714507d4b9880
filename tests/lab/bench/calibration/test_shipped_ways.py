"""The five shipped ways, each on an elastic robot; pictures of dots show what they should."""

import numpy as np
import pytest
from lipservo_lab.bench.calibration.elastic_draws import draw_elastic_robot
from lipservo_lab.bench.calibration.shipped_ways import WAYS, way_figures, write_dots_pictures
from small_model import small_model

from calibration.capture.dots import DotsFolder
from calibration.simulated.elastic_robot import ElasticFace
from lipsync.markers import MARKERS_47

MODEL = small_model()


def test_pictures_of_dots_say_where_the_markers_are_across_and_up(tmp_path):
    pytest.importorskip("cv2", reason="dots need OpenCV, the extra `dots`")
    draw, _ = draw_elastic_robot(MODEL.markers_mm(MODEL.rest[None])[0], 3, 4)
    opened_deg = np.where(np.arange(4) == draw.jaw, 0.5, 0.0) * draw.signs * 24.0
    markers_mm = ElasticFace(draw).markers_mm(np.array([np.zeros(4), opened_deg]))
    write_dots_pictures(tmp_path, MARKERS_47.names, markers_mm, seed=0)
    folder = DotsFolder(tmp_path)
    for pose in (1, 2):
        seen = {n: place for _, n, place in folder.readings(pose) if np.isfinite(place).all()}
        assert len(seen) >= 45
        at = [MARKERS_47.names.index(name) for name in seen]
        off_mm = np.array(list(seen.values()))[:, :2] - markers_mm[pose - 1, at, :2]
        # Where the picture begins nobody knows: all are as far off.
        off_mm = off_mm - np.median(off_mm, axis=0)
        assert np.sqrt(np.mean(off_mm**2)) < 0.25


@pytest.mark.slow
def test_every_way_calibrates_robots_of_one_and_four_servos():
    pytest.importorskip("cv2", reason="dots need OpenCV, the extra `dots`")
    found = way_figures(MODEL, 3, (1, 4))
    assert set(found) == set(WAYS) == {"measured", "guided", "practise", "port", "hobby", "dots"}
    for way, by_size in found.items():
        assert set(by_size) == {"1", "4"}
        for off_mm in by_size.values():
            assert isinstance(off_mm, float), (way, off_mm)
            assert 0.0 < off_mm < 3.0, (way, off_mm)
