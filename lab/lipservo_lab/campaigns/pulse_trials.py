"""Trials of hobby servos, checked by their pulses alone.

The simulators of these buses have `FAULTS`, `read_faults` and `watched_servos`.
"""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from firmware_bridge.bus_kinds import Wiring, bus_kind
from firmware_bridge.joints import Joint
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.pulse_servos import PulseServo
from firmware_bridge.stopping import StopLevel, StopReport
from lipservo_lab.campaigns.fault_campaign import MAX_SPEED_DEG_S, Case, Trials

#: Settings under `bus:` besides the kind.
_SETTINGS: Final[Mapping[str, Mapping[str, Any]]] = {
    # Without a CRC a damaged byte is another order, within the range set in the Maestro.
    "maestro": {"model": "mini18", "crc": True},
    "pca9685": {},
}
_US_PER_DEG: Final = 10.0
#: A count of a PCA9685 at 50 Hz is 4.9 us, and goals are rounded to one.
_ROUNDING_US: Final = 5.0
#: Pulses come every 20 ms: a channel without one for longer than this was switched off.
_ENDED_S: Final = 0.1
#: Orders on their way when a person froze the face have arrived by then.
_BRAKES_S: Final = 0.1
#: The last pulse of a board may still be on its way when the channel is switched off.
_LAST_PULSE_S: Final = 0.045


def wiring_of(case: Case) -> Wiring:
    """Return the wiring of hobby servos for a case; every other servo is mounted reversed."""
    joints = tuple(
        Joint(f"joint_{n}", n, -30.0, 40.0, MAX_SPEED_DEG_S, address_key="channel")
        for n in range(case.n_servos)
    )
    servos = tuple(
        PulseServo(
            channel=joint.servo_id,
            positive="opens",
            min_deg=joint.min_deg,
            max_deg=joint.max_deg,
            max_speed_deg_s=joint.max_speed_deg_s,
            us_per_deg=_US_PER_DEG if n % 2 else -_US_PER_DEG,
        )
        for n, joint in enumerate(joints)
    )
    settings = bus_kind(case.bus).settings.model_validate(_SETTINGS[case.bus])
    return Wiring(settings, joints, servos, case.rate_hz)


class PulseAuditor:
    """Checks every servo's pulses; all counts are of pulses of one servo.

    goals_outside: outside the joint's range, or on a channel without servo. steps_too_long: farther
    from the one before than top speed allows. armed_wrongly: the first after a pause is elsewhere
    than the last, by more than top speed allows in two periods. armed_late: the first after a pause
    comes after a person's stop. moved_frozen: differs from the one before, later than 0.1 s after a
    person froze the face.
    """

    def __init__(self, wiring: Wiring) -> None:
        """Prepare to check the pulses of the servos in a wiring."""
        self._last_us = {each.channel: each.neutral_us for each in wiring.servos}
        self._last_s = dict.fromkeys(self._last_us, -math.inf)
        self._off_s = dict.fromkeys(self._last_us, -math.inf)
        ends = [
            sorted(each.neutral_us + each.us_per_deg * deg for deg in (each.min_deg, each.max_deg))
            for each in wiring.servos
        ]
        self._range = dict(zip(self._last_us, ends, strict=True))
        period_s = max(1.0 / wiring.rate_hz, 0.02)
        self._period_s, self._top_us_s = period_s, MAX_SPEED_DEG_S * _US_PER_DEG
        self._stopped_s = math.inf
        self._is_frozen = False
        self.goals_outside = self.steps_too_long = self.armed_wrongly = 0
        self.armed_late = self.moved_frozen = 0

    def note_stop(self, time_s: float, level: StopLevel) -> None:
        """Note a person's stop; after a freeze no shaft may move until the face is let go."""
        self._stopped_s = time_s
        self._is_frozen = level is StopLevel.FREEZE

    def let_go(self) -> None:
        """Note that a frozen face is released now, and may move."""
        self._is_frozen = False

    def see(self, time_s: float, channel: int, pulse_us: float, *, comes_again: bool) -> None:
        """Check one pulse of a channel, us (0: none), against range, speed and stop.

        comes_again: True for a board that reports every pulse, False for one that reports changes
        only.
        """
        if channel not in self._range:
            self.goals_outside += pulse_us > 0.0
            return
        before_us, before_s = self._last_us[channel], self._last_s[channel]
        if pulse_us == 0.0:
            self._off_s[channel] = min(self._off_s[channel], time_s)
            return
        off_s = before_s if comes_again else self._off_s[channel]
        self._last_us[channel], self._last_s[channel] = pulse_us, time_s
        self._off_s[channel] = math.inf
        low_us, high_us = self._range[channel]
        self.goals_outside += not low_us - _ROUNDING_US <= pulse_us <= high_us + _ROUNDING_US
        step_us = abs(pulse_us - before_us)
        if time_s - off_s > _ENDED_S:
            # The last order before a break of the supply may have been cut short.
            reach_us = 2.0 * self._top_us_s * self._period_s
            self.armed_wrongly += step_us > reach_us + _ROUNDING_US
            self.armed_late += time_s > self._stopped_s + _LAST_PULSE_S
            return
        # After a lost message the next one makes the step of both; and a Maestro, which moves to a
        # target at its own speed, may not have finished the step before.
        n_periods = 3.0 if off_s < math.inf and not comes_again else 1.0
        reach_us = self._top_us_s * n_periods * self._period_s
        self.steps_too_long += step_us > reach_us + _ROUNDING_US
        is_late = time_s > self._stopped_s + _BRAKES_S
        self.moved_frozen += self._is_frozen and is_late and step_us > _ROUNDING_US

    def last_s(self) -> float:
        """Return when the last pulse of any servo began."""
        return max(self._last_s.values())

    def n_on(self) -> int:
        """Return the number of servos that get pulses, for a board that reports changes only."""
        return sum(
            off_s == math.inf and self._last_s[channel] > -math.inf
            for channel, off_s in self._off_s.items()
        )


class PulseStage:
    """Hobby servos with a fault; see `fault_campaign.Stage`."""

    def __init__(self, case: Case) -> None:
        """Make the simulated bus of a case, with its faults, watched by an auditor."""
        wiring, simulator = wiring_of(case), bus_kind(case.bus).simulator()
        self.joints: Sequence[Joint] = wiring.joints
        self.auditor = PulseAuditor(wiring)
        see, self._is_board = _pulse_callback(self.auditor, case.bus)
        rows = [{"kind": case.kind, "at_s": at, "lasts_s": lasts} for at, lasts in case.times_s()]
        faults = simulator.read_faults(json.dumps({"faults": rows}))
        self._watched = simulator.watched_servos(wiring, faults=faults, on_pulse=see)
        self.bus, self.clock = self._watched.bus, self._watched.clock
        self._claims = 0

    def look(self, bridge: Bridge) -> None:
        """Count reported positions and health values that no sensor measures."""
        feedback = bridge.feedback
        places = 0 if feedback is None else int(np.isfinite(feedback.positions_deg).sum())
        unknown = ("temperature_degc", "load", "voltage_v", "current_ma")
        values = [getattr(each, name) for each in bridge.servo_health() for name in unknown]
        self._claims += places + sum(each is not None and math.isfinite(each) for each in values)

    def look_at_last(self) -> None:
        """Check nothing: hobby servos report nothing."""

    def counts(self, report: StopReport | None) -> Mapping[str, int]:
        """Return counts of the pulses, including those in the second after the end.

        claims: reported positions, loads, temperatures, voltages or words about torque that no
        hobby servo can report. pulses_left_on: channels that go on although they can be switched
        off.
        """
        ended_s, is_reachable = self.clock.now(), self._watched.is_reachable()
        self.clock.advance(1.0)
        self._watched.shafts_deg()
        auditor = self.auditor
        goes_on = auditor.last_s() > ended_s + _LAST_PULSE_S if self._is_board else auditor.n_on()
        return {
            "goals_outside_limits": auditor.goals_outside,
            "steps_above_clamp": auditor.steps_too_long,
            "armed_wrongly": auditor.armed_wrongly,
            "undone": auditor.armed_late,
            "moved_frozen": auditor.moved_frozen,
            "claims": self._claims + _n_torque_words(report),
            "pulses_left_on": int(goes_on) if is_reachable else 0,
        }


def _pulse_callback(auditor: PulseAuditor, bus: str) -> tuple[Callable[[Any], None], bool]:
    """Return the callback for a bus's simulator, and whether it is called for every pulse."""
    if bus == "maestro":
        return lambda p: auditor.see(p.time_s, p.channel, p.pulse_us, comes_again=False), False

    def see(pulse: Any) -> None:
        if not pulse.is_cut:  # what the supply cut short is no order of anybody
            auditor.see(pulse.start_s, pulse.channel, pulse.width_us, comes_again=True)

    return see, True


def _n_torque_words(report: StopReport | None) -> int:
    """Return the number of statements in a report that only a servo with feedback could make."""
    if report is None:
        return 0
    text = f"{report.text()} {report.line()}"
    return len(report.confirmed) + ("limp" in text) + ("confirmed by" in text)


_MUST_NOT: Final = (
    "goals_outside_limits",
    "steps_above_clamp",
    "armed_wrongly",
    "undone",
    "moved_frozen",
    "claims",
    "pulses_left_on",
)


def _trials(bus: str) -> Trials:
    faults = bus_kind(bus).simulator().FAULTS
    return Trials(faults, (1, 5, 16), (30.0, 50.0), _MUST_NOT, PulseStage)


MAESTRO, PCA9685 = _trials("maestro"), _trials("pca9685")
