"""How awake a face is, from its cues: in conversation, idle, or at rest."""

from lipsync.expression.cue import CUE_PERIOD_S, ExpressionCue, bounded, smoothstep, toward

#: From idle to conversation: short enough for the first word, long enough for no jolt.
WAKING_S = 0.8
#: From conversation to idle.
CALMING_S = 3.0
#: Between talking and listening.
_TURN_S = 0.5
#: A target that moved as far as this is somebody moving, not a tracker's noise.
MOVED_DEG = 2.0
_FURTHEST_YAW_DEG, _FURTHEST_PITCH_DEG = 60.0, 40.0


class Alertness:
    """The state of the conversation from the newest cue, smoothed, for all expression generators.

    awake: 1 in conversation, 0 in idle. talking: 1 while the robot speaks. is_idle, is_speaking:
    these two states without smoothing; idle comes after `idle_after_s` of silence. wants_rest: for
    `rest_after_s` there was no speech and no person moved. partner_deg: (yaw, pitch) of the person
    to look at; straight ahead where there is none. has_turned: in this cue that person appeared,
    left, or moved by more than 2 degrees. turn_ended: in this cue the robot's speech ended, or a
    person's pause reached 0.3 s.
    """

    def __init__(self, idle_after_s: float, rest_after_s: float) -> None:
        """Start in idle; the parameters are those of the class."""
        self._idle_after_s = idle_after_s
        self._rest_after_s = rest_after_s
        self._awake_share = 0.0
        self._talking_share = 0.0
        self._unmoved_s = 0.0
        self._noticed_deg: tuple[float, float] | None = None
        self._silent_s = 0.0
        self.awake = 0.0
        self.talking = 0.0
        self.is_speaking = False
        self.is_idle = True
        self.wants_rest = False
        self.partner_deg = (0.0, 0.0)
        self.has_turned = False
        self.turn_ended = False

    def update(self, cue: ExpressionCue) -> None:
        """Update the state by the next cue, 10 ms after the last cue."""
        silent_s = 0.0 if cue.is_speaking else bounded(cue.silent_s, 0.0, 1e9)
        # The robot has just stopped, or a person's silence has just become a pause.
        self.turn_ended = (self.is_speaking and not cue.is_speaking) or (
            not cue.is_speaking and self._silent_s < _PAUSE_S <= silent_s
        )
        self.is_speaking = cue.is_speaking
        self._silent_s = silent_s
        self._notice_partner(cue.look_at_deg)
        self.is_idle = silent_s > self._idle_after_s
        self.wants_rest = min(silent_s, self._unmoved_s) >= self._rest_after_s
        if self.wants_rest:
            self.partner_deg = (0.0, 0.0)
        step_s = CUE_PERIOD_S / (CALMING_S if self.is_idle else WAKING_S)
        self._awake_share = toward(self._awake_share, 0.0 if self.is_idle else 1.0, step_s)
        self.awake = smoothstep(self._awake_share)
        step_s = CUE_PERIOD_S / _TURN_S
        self._talking_share = toward(self._talking_share, float(cue.is_speaking), step_s)
        self.talking = smoothstep(self._talking_share)

    def _notice_partner(self, look_at_deg: tuple[float, float] | None) -> None:
        """Update by one cue where the partner is, whether it has turned, and how long nobody moved.

        look_at_deg: (yaw, pitch) of the person to look at; None: nobody.
        """
        target_deg = _clipped_target(look_at_deg)
        noticed_deg = self._noticed_deg
        if target_deg is None or noticed_deg is None:
            self.has_turned = target_deg is not noticed_deg
        else:
            across_deg, up_deg = target_deg[0] - noticed_deg[0], target_deg[1] - noticed_deg[1]
            self.has_turned = across_deg**2 + up_deg**2 > MOVED_DEG**2
        if self.has_turned:
            self._noticed_deg = target_deg
            self._unmoved_s = 0.0
        else:
            self._unmoved_s += CUE_PERIOD_S
        self.partner_deg = target_deg or (0.0, 0.0)


#: Whoever listens takes a silence of the other as the end of a phrase after this time, as the
#: face's own speech side does.
_PAUSE_S = 0.3


def _clipped_target(look_at_deg: tuple[float, float] | None) -> tuple[float, float] | None:
    """Return a target's (yaw, pitch) clipped to +-60 and +-40 degrees; None: no target, or NaN."""
    if look_at_deg is None:
        return None
    yaw_deg, pitch_deg = look_at_deg
    if yaw_deg != yaw_deg or pitch_deg != pitch_deg:
        return None
    return (
        bounded(yaw_deg, -_FURTHEST_YAW_DEG, _FURTHEST_YAW_DEG),
        bounded(pitch_deg, -_FURTHEST_PITCH_DEG, _FURTHEST_PITCH_DEG),
    )
