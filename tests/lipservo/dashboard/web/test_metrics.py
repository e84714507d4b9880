"""Metrics, read by the library that Prometheus's own clients use: never better than it is."""

import math

import pytest
from prometheus_client.parser import text_string_to_metric_families

from lipservo.dashboard.face_link import FaceLink
from lipservo.dashboard.live_frames import Snapshot
from lipservo.dashboard.web.metrics import FaceCollector, metrics_text

STATUS = {
    "state": "driven",
    "servos": {"jaw": "driven", "neck": "waiting", "brow": "driven"},
    "health": [
        {"name": "jaw", "servo_id": 11, "state": "driven", "temperature_degc": 41.0, "load": 0.25,
         "voltage_v": 5.1, "current_ma": None, "hardware_errors": 0, "n_reboots": 1,
         "n_unanswered": 3, "torque_on": True},
        {"name": "neck", "servo_id": 12, "state": "waiting", "temperature_degc": None,
         "load": None, "voltage_v": None, "current_ma": None, "hardware_errors": None,
         "n_reboots": 0, "n_unanswered": 90, "torque_on": None},
    ],
    "n_ticks": 1000, "n_late": 2, "n_stale": 0, "delay_ms": 227.0, "fallback_level": 0,
}  # fmt: skip


class Known(FaceLink):
    """A link that has just been told, by nobody."""

    def __init__(self, status, *, answers=True, servos_gone=False):
        super().__init__(lambda: None)
        self.status = status
        self.snapshot = Snapshot(1, 0.0, servos_gone=servos_gone)
        self._is_answering = answers

    @property
    def answers(self):
        return self._is_answering


def scraped_values(status=None, **about):
    """Return the metrics of a status, parsed as Prometheus does: value by (name, *label values)."""
    link = Known(STATUS if status is None else status, **about)
    text = metrics_text(FaceCollector(link, lambda: {"twin": 2, "state": 0})).decode()
    return {
        (sample.name, *sample.labels.values()): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


def test_a_face_that_is_well():
    found = scraped_values()

    assert found["lipservo_up",] == 1
    assert found["lipservo_servo_answers", "jaw"] == 1
    assert found["lipservo_servo_temperature_celsius", "jaw"] == 41.0
    assert found["lipservo_servo_load_ratio", "jaw"] == 0.25
    assert found["lipservo_servo_reboots_total", "jaw"] == 1
    assert found["lipservo_late_ticks_total",] == 2
    assert found["lipservo_delay_seconds",] == pytest.approx(0.227)
    assert found["lipservo_face_state", "driven"] == 1
    assert found["lipservo_dashboard_clients", "twin"] == 2
    assert not any(math.isnan(value) for value in found.values())


def test_a_servo_that_was_never_heard_has_no_figures():
    found = scraped_values()

    for name in ("neck", "brow"):
        assert found["lipservo_servo_answers", name] == 0
        for figure in ("temperature_celsius", "voltage_volts", "hardware_errors", "torque_on"):
            assert (f"lipservo_servo_{figure}", name) not in found
    assert found["lipservo_servo_driven", "neck"] == 0


@pytest.mark.parametrize("about", [{"answers": False}, {"servos_gone": True}], ids=str)
def test_of_a_face_that_is_gone_no_old_figure_is_told(about):
    found = scraped_values(**about)

    assert found["lipservo_up",] == 0
    for name in ("jaw", "neck", "brow"):
        assert found["lipservo_servo_answers", name] == 0
        assert found["lipservo_servo_driven", name] == 0
        assert ("lipservo_servo_temperature_celsius", name) not in found
    if not about.get("answers", True):
        assert ("lipservo_face_state", "driven") not in found
        assert ("lipservo_late_ticks_total",) not in found


def test_of_no_face_at_all_it_is_told_that_there_is_none():
    found = scraped_values({}, answers=False, servos_gone=True)
    assert found["lipservo_up",] == 0
    assert not any(name.startswith("lipservo_servo_") for name, *_ in found)
