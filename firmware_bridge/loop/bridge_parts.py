"""The parts of a bridge, and what they tell of it to whoever looks."""

from collections.abc import Mapping, Sequence

from firmware_bridge.bus import ServoBus
from firmware_bridge.health import Feedback, ServoHealth, ServoState
from firmware_bridge.joints import Joint
from firmware_bridge.loop.ease_to_neutral import EaseToNeutral
from firmware_bridge.loop.followed_targets import FollowedTargets
from firmware_bridge.loop.jog import Jog
from firmware_bridge.loop.port_retry import PortRetry
from firmware_bridge.loop.report import BridgeStatus, FaceState
from firmware_bridge.loop.servo_group import ServoGroup
from firmware_bridge.loop.settings import BridgeSettings
from firmware_bridge.loop.single_servos import SingleServos
from firmware_bridge.targets import TargetChannel


class BridgeParts:
    """Nothing here moves anything: `firmware_bridge.loop.bridge.Bridge` does."""

    def __init__(
        self,
        bus: ServoBus,
        joints: Sequence[Joint],
        channel: TargetChannel,
        settings: BridgeSettings,
    ) -> None:
        """Joints and targets share their order."""
        self._joints = tuple(joints)
        self._settings = settings
        self._targets = FollowedTargets(channel, len(self._joints), settings.stale)
        self._servos = ServoGroup(bus, joints, settings)
        self._jog = Jog(self._joints, settings.period_s)
        self._single = SingleServos(self._joints, self._servos, self._jog)
        self._state, self._port = FaceState.STOPPED, PortRetry()
        self._tick_s = 0.0
        self._easing: EaseToNeutral | None = None
        self._n_ticks = self._n_late = self._n_stale = self._n_armed = 0
        #: Why the face stopped by itself; empty: it did not.
        self.failure = ""

    @property
    def rate_hz(self) -> float:
        """The nominal rate of `tick`."""
        return self._settings.rate_hz

    @property
    def state(self) -> FaceState:
        """What the face is doing."""
        return self._state

    @property
    def names(self) -> tuple[str, ...]:
        """The joints, in the order of everything else."""
        return tuple(joint.name for joint in self._joints)

    @property
    def plugged(self) -> bool:
        """Whether the port is there."""
        return self._port.is_open

    @property
    def tick_counts(self) -> tuple[int, int, int]:
        """Ticks so far, those missed, and those without a fresh target, as `status` counts them."""
        return self._n_ticks, self._n_late, self._n_stale

    @property
    def status(self) -> BridgeStatus:
        """The counts so far."""
        return BridgeStatus(
            state=self._state,
            n_ticks=self._n_ticks,
            n_late=self._n_late,
            n_stale=self._n_stale,
            n_armed=self._n_armed,
            n_rejected_targets=self._targets.n_rejected,
            gate=self._servos.limiter.counts,
            n_unplugged=self._port.n_lost,
            servo_states=tuple(
                ServoState(state) for state in self._servos.supervision.states.tolist()
            ),
        )

    @property
    def feedback(self) -> Feedback | None:
        """Where the servos stood in the last tick; None before it, and while the port is gone."""
        return self._servos.feedback if self._port.is_open else None

    @property
    def jogged(self) -> tuple[str, ...]:
        """The joints that a person jogs just now."""
        return tuple(self._joints[index].name for index in self._jog.jogged)

    @property
    def n_trouble_changes(self) -> int:
        """Grows whenever `troubles` changes, so that a loop need not look at texts."""
        return self._servos.supervision.n_changes

    @property
    def settled(self) -> bool:
        """Whether every servo is driven, or `troubles` says why not."""
        return self._servos.supervision.settled

    @property
    def given_up(self) -> Mapping[int, str]:
        """Servos that stay limp for good, by index, with the reason."""
        return self._servos.gate.given_up

    @property
    def troubles(self) -> tuple[str, ...]:
        """A line for each servo that is not driven, with the reason; for a log, not for a tick."""
        return self._servos.troubles

    def remarks(self) -> Sequence[str]:
        """What is unusual about the bus, in sentences for a log; they stay and become more."""
        return self._servos.remarks()

    def servo_health(self) -> tuple[ServoHealth, ...]:
        """How every servo was when it was asked last; for a log, not for a tick."""
        return self._servos.health()

    def health_records(self) -> list[dict[str, object]]:
        """The same for JSON, quickly made: None for what was never heard."""
        return self._servos.health_records()
