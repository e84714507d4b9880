"""A face that a person moves with keys or from its page: without speech or calibration.

It is held in neutral through the usual safety gate; moving single joints (jogging) uses the orders
that a speaking face accepts.
"""

from collections.abc import Callable
from typing import Final

import numpy as np

from firmware_bridge.bus import ServoBus
from firmware_bridge.clock import Clock
from firmware_bridge.gate.ramp import Ramp
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.targets import MemoryTargetChannel, ServoTargets
from firmware_bridge.stopping import ArmJog, JogPulse, JogTo, StopReport
from lipservo.runtime.servos.driven_face import ControlOptions, DriveOptions, driven_face
from lipservo.runtime.servos.held_face import SPEED_DEG_S
from lipservo.runtime.status.silent_board import SilentBoard
from lipservo.settings.settings import FaceSettings


def drive_by_hand(
    settings: FaceSettings,
    config: str,
    clock: Clock,
    act: Callable[[Bridge, float], bool] = lambda _bridge, _time_s: True,
    bus: ServoBus | None = None,
) -> tuple[StopReport, int | None]:
    """Hold the face in neutral until a person stops it; return (stop report, number of the signal).

    The number is None if no signal stopped it. config: the face's name or YAML path, for its
    status. act: called in each tick with the bridge and the monotonic time, to give orders to the
    bridge; when it returns False, the face comes to rest and goes limp. bus: not yet entered; None:
    the face's own. Raises what bus and bridge raise.
    """
    channel = MemoryTargetChannel()
    with SilentBoard.create(settings, config) as board:
        control = ControlOptions(about={"config": config}, watched_fd=board.fileno)
        how = DriveOptions(control=control)
        with driven_face(settings, clock, channel, how, bus) as driven:
            bridge, life = driven.bridge, driven.life
            life.start()
            start_deg = driven.bus.read().start_deg(driven.bus.capabilities)
            ramp = Ramp.at_speed(start_deg, np.zeros_like(start_deg), clock.now(), SPEED_DEG_S)
            for time_s, late in life.ticks():
                if not life.stopping and not act(bridge, time_s):
                    life.stop()
                channel.publish(ServoTargets(time_s, ramp.at(time_s)))
                board.tell(bridge, bridge.tick(time_s, late))
    assert life.report is not None
    return life.report, life.signal_number


#: How far a key moves the joint: a hobby servo in microseconds of its pulse, others in degrees.
STEPS: Final = {
    "-": (-10.0, -1.0),
    "+": (10.0, 1.0),
    "=": (10.0, 1.0),  # the key of + without shift
    ",": (-2.0, -0.1),
    ".": (2.0, 0.1),
}
NEUTRAL_KEY: Final = "0"
AGREE_KEY: Final = "y"
#: The bridge ends a jog order that is not renewed; within the joint's limits it is, so often.
_RENEW_S: Final = 1.0


class KeyedJoint:
    """One joint that a person moves with keys of a terminal.

    place: its goal position, in us for a hobby servo, in degrees for any other.
    """

    def __init__(self, settings: FaceSettings, name: str) -> None:
        """Create the state of the face's joint `name`, with its goal at neutral."""
        joint = next(each for each in settings.joints() if each.name == name)
        self.name, self.joint, self.pulse = name, joint, joint.pulse
        self.place = self._neutral = 0.0 if joint.pulse is None else joint.pulse.neutral_us
        # Beyond the limits of its pulses: whether a person has agreed, and whether that was asked.
        self._may_go_beyond = self._may_confirm = False
        # Monotonic time of the present jog order; -inf: there is none.
        self._ordered_s = -np.inf

    @property
    def shown(self) -> str:
        """The goal position as text for a person."""
        if self.pulse is None:
            return f"{self.name} {self.place:.1f} deg"
        return f"{self.name} {self.place:.0f} us ({self.pulse.deg(self.place):.1f} deg)"

    def press(self, key: str, bridge: Bridge, time_s: float) -> str | None:
        """Carry out a pressed key; return "" if done, the reason if refused, None if unknown.

        bridge: gets the jog order. time_s: monotonic time of the present tick.
        """
        if key == AGREE_KEY and self._may_confirm:
            self._may_go_beyond = True
            return ""
        if key == NEUTRAL_KEY:
            return self._jog(self._neutral, bridge, time_s)
        if key not in STEPS:
            return None
        pulse_step, degree_step = STEPS[key]
        step = degree_step if self.pulse is None else pulse_step
        return self._jog(round(self.place + step, 1), bridge, time_s)

    def renew(self, bridge: Bridge, time_s: float) -> bool:
        """Renew the jog order once a second; return False in the tick after the bridge ended it.

        Call in each tick, at monotonic `time_s`. An order beyond the joint's limits is not renewed,
        and so ends by itself. After the end the joint is back at neutral, and so is `place`.
        """
        if self.name not in bridge.jogged:
            had_order, self._ordered_s = np.isfinite(self._ordered_s), -np.inf
            if had_order:
                self.place = self._neutral
            return not had_order
        if self._is_within(self.place) and time_s - self._ordered_s >= _RENEW_S:
            self._ordered_s = time_s
            # Keeps the present order in force.
            bridge.obey(ArmJog(), time_s)
        return True

    def _jog(self, place: float, bridge: Bridge, time_s: float) -> str:
        """Order the joint to go to `place`; return why that was refused, "" if it was not.

        place: in us for a hobby servo, in degrees for others. Beyond the limits of a hobby servo, a
        person first has to agree by a key.
        """
        if not (self._is_within(place) or self._may_go_beyond):
            self._may_confirm = True
            return f"press {AGREE_KEY} to go beyond its limits"
        # The bridge accepts an order only while jogging is armed.
        bridge.obey(ArmJog(), time_s)
        order = JogTo if self.pulse is None else JogPulse
        why_not = bridge.obey(order(self.name, place), time_s)
        if not why_not:
            self.place, self._ordered_s = place, time_s
        return why_not

    def _is_within(self, place: float) -> bool:
        if self.pulse is None:
            return True  # the safety gate refuses other angles
        return self.pulse.min_us <= place <= self.pulse.max_us
