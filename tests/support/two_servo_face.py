"""The YAML of a face with two servos, and how it is read or refused."""

import pytest

from lipservo.settings.settings import load_face
from lipservo.settings.strict_yaml import SettingsError

FACE = """\
name: test face
rate_hz: 50
calibration: face.calibration.yaml
bus:
  kind: simulated
servos:
  jaw:
    id: 3
    model: XL330-M288
    positive: opens
    min_deg: -2
    max_deg: 25.5
    max_speed_deg_s: 300
  lip:
    id: 4
    model: XM430-W350
    positive: raises
    min_deg: -30
    max_deg: 30
    max_speed_deg_s: 200
    sign: -1
    zero_offset_deg: 1.5
"""


def load(tmp_path, text):
    path = tmp_path / "face.yaml"
    path.write_text(text, encoding="utf-8")
    return load_face(path)


def errors_in(tmp_path, text):
    with pytest.raises(SettingsError) as caught:
        load(tmp_path, text)
    return str(caught.value).splitlines()
