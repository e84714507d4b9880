"""`/metrics` for Prometheus. An unknown figure is left out, never replaced by a good one."""

from collections.abc import Callable, Iterable
from typing import Any, Final

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from lipservo.dashboard.face_link import FaceLink
from lipservo.dashboard.servo_remedies import listed_servos

CONTENT_TYPE: Final = "text/plain; version=0.0.4; charset=utf-8"
#: Gauges of each servo: name, field of `listed_servos`, description.
_SERVO_GAUGES: Final = (
    ("temperature_celsius", "temperature_degc", "inside the servo"),
    ("load_ratio", "load", "share of the stall torque"),
    ("voltage_volts", "voltage_v", "at the servo"),
    ("current_milliamperes", "current_ma", "of models that measure it"),
    ("hardware_errors", "hardware_errors", "bits of hardware_error_status"),
    ("torque_on", "torque_on", "as its register says"),
)
_SERVO_COUNTS: Final = (
    ("reboots", "n_reboots", "restarts by the bridge"),
    ("unanswered", "n_unanswered", "questions of a tick that it did not answer"),
)
_COUNTS: Final = (
    ("ticks", "n_ticks", "ticks of the bridge"),
    ("late_ticks", "n_late", "ticks skipped because the computer was busy"),
    ("stale_ticks", "n_stale", "ticks without a fresh target"),
    ("unplugged", "n_unplugged", "how often the port was lost"),
    ("rejected_targets", "n_rejected_targets", "targets that could not be used"),
    ("range_hits", "range_hits_total", "goals clamped to a range"),
    ("rate_hits", "rate_hits_total", "goals slowed"),
    ("prevented", "prevented_total", "goals changed by a rule between joints"),
    ("lost_sound_blocks", "n_lost_sound_blocks", "blocks of 10 ms not heard"),
)


class FaceCollector(Collector):
    """A Prometheus collector of a face's figures at the time of each request."""

    def __init__(self, link: FaceLink, n_clients: Callable[[], dict[str, int]]) -> None:
        """Collect from `link`. n_clients: returns the number of clients of each stream by name."""
        self._link = link
        self._n_clients = n_clients

    def collect(self) -> Iterable[Metric]:
        """Yield every metric; while the face does not answer, none from its status."""
        link = self._link
        certainty = link.certainty()
        is_fresh = bool(certainty["face_answers"])
        yield _gauge("lipservo_up", "1: the face answers and its servo side ticks", certainty["up"])
        for side in ("servos", "speech"):
            description = f"1: the {side} side has reported nothing for a second"
            yield _gauge(f"lipservo_{side}_gone", description, certainty[f"{side}_gone"])
        if link.status is not None:
            yield _gauge(
                "lipservo_status_age_seconds", "since the face answered", link.status_age_s
            )
        clients = GaugeMetricFamily("lipservo_dashboard_clients", "of a stream", labels=["stream"])
        for stream, n in self._n_clients().items():
            clients.add_metric([stream], n)
        yield clients
        status = (link.status or {}) if is_fresh else {}
        if status.get("state"):
            state = GaugeMetricFamily("lipservo_face_state", "1: it is so", labels=["state"])
            for each in dict.fromkeys([*link.layout.states, str(status["state"])]):
                state.add_metric([each], each == status["state"])
            yield state
        for name, field, description in _COUNTS:
            if status.get(field) is not None:
                yield CounterMetricFamily(f"lipservo_{name}", description, value=status[field])
        if status.get("delay_ms") is not None:
            description = "from sound to face"
            yield _gauge("lipservo_delay_seconds", description, 1e-3 * status["delay_ms"])
        if status.get("fallback_level") is not None:
            description = "recognisers that were left"
            yield _gauge(
                "lipservo_recognizer_fallback_level", description, status["fallback_level"]
            )
        yield from self._servo_metrics(is_fresh and not link.snapshot.servos_gone)

    def _servo_metrics(self, is_fresh: bool) -> Iterable[Metric]:
        """Yield the metrics of all servos; figures that are not known are left out.

        is_fresh: the face's status and servo records are current.
        """
        servos = listed_servos(self._link.status, is_fresh=is_fresh)
        answers = GaugeMetricFamily(
            "lipservo_servo_answers", "1: something is known of it now", labels=["servo"]
        )
        for servo in servos:
            answers.add_metric([servo["name"]], servo["answers"])
        yield answers
        for name, field, description in (*_SERVO_GAUGES, *_SERVO_COUNTS):
            kind: Any = GaugeMetricFamily
            if (name, field, description) in _SERVO_COUNTS:
                kind = CounterMetricFamily
            family = kind(f"lipservo_servo_{name}", description, labels=["servo"])
            for servo in servos:
                if servo[field] is not None:
                    family.add_metric([servo["name"]], float(servo[field]))
            yield family
        driven = GaugeMetricFamily("lipservo_servo_driven", "1: it is driven", labels=["servo"])
        for servo in servos:
            driven.add_metric([servo["name"]], servo["state"] == "driven")
        yield driven


def metrics_text(collector: Collector) -> bytes:
    """Return the metrics in Prometheus' text format."""
    registry = CollectorRegistry(auto_describe=False)
    registry.register(collector)
    return generate_latest(registry)


def _gauge(name: str, description: str, value: Any) -> GaugeMetricFamily:
    return GaugeMetricFamily(name, description, value=float(value))
