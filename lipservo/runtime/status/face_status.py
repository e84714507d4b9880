"""The status of a whole face: a record of the servo side and one of the speech side, joined.

The terminal view, `--json`, `lipservo status` and the summary read it. What is not known at the
moment is None. docs/architecture.md has the same fields as a table, which a test keeps true.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any


@dataclass(frozen=True, slots=True)
class BridgeSide:
    """The status of the servo side, from the process that drives it, else from the supervisor.

    name: of the face; config: its YAML, by the name of a shipped face or by its path; sounds: the
    folder whose sound files may be played; port: of its servos, None: simulated in memory; state: a
    `FaceState`, or the supervisor's state while no bridge runs; dry_run: whether the servos are
    only read; stopped: a person's stop that is in
    force, and stopped_by: its requester; stop_report: the servos' report of that stop
    (`StopReport`), None before it; can_start: whether a person can start the face now; plugged:
    whether the port exists; torque_on: whether any servo is known to hold, False: every one is
    known to be off; torque: on and age_s of each, by name, on None where it is not known; servos:
    the state of each, by name; troubles: a line for each servo that is not driven, and one while
    ticks or motion come late; jogged: joints that a person jogs; health: readings of each servo
    (`ServoHealth`), None for one never received; capabilities: what the bus can do
    (`BusCapabilities`); pulses: of each hobby servo, by name, its limits and the pulse it gets;
    n_ticks to n_unplugged: `TickCounts`; *_total: how often the gate changed a goal, over all
    servos; bridge_pid: the process that drives them.
    """

    name: str = ""
    config: str | None = None
    sounds: str | None = None
    port: str | None = None
    state: str = ""
    dry_run: bool | None = None
    stopped: str | None = None
    stopped_by: str | None = None
    stop_report: Mapping[str, object] | None = None
    can_start: bool | None = None
    plugged: bool | None = None
    torque_on: bool | None = None
    torque: Mapping[str, Mapping[str, bool | float | None]] = field(default_factory=dict)
    servos: Mapping[str, str] = field(default_factory=dict)
    troubles: Sequence[str] = ()
    jogged: Sequence[str] = ()
    health: Sequence[Mapping[str, object]] = ()
    capabilities: Mapping[str, object] = field(default_factory=dict)
    pulses: Mapping[str, Mapping[str, float | None]] = field(default_factory=dict)
    n_ticks: int | None = None
    n_late: int | None = None
    n_stale: int | None = None
    n_armed: int | None = None
    n_unplugged: int | None = None
    n_rejected_targets: int | None = None
    range_hits_total: int | None = None
    rate_hits_total: int | None = None
    rejected_total: int | None = None
    prevented_total: int | None = None
    bridge_pid: int | None = None


@dataclass(frozen=True, slots=True)
class SpeechStatus:
    """The status of the speech side.

    sound: name of the file or device. recognizer: the one in use; fallback_level: number of better
    ones that are not in use, 0: the best is; fallback_reasons: why each of these is not. engine,
    weights, strategy: as requested. settings: the strategy's settings, as set last. hears: the
    class of the sound, `speech`, `noise` or `silence`; moved_by: the source of the phonemes,
    `sound`, `text`, `words`, `phonemes` or `visemes`; units_shifted_ms: how much later than sent
    phonemes and visemes are heard and shown, None: none are; words: those around the spoken one, as
    far as they are known, word: the spoken one's index. delay_ms: from a sound to the face shown
    for it. n_phonemes: those that moved the mouth; n_lost_sound_blocks: sound not received. output:
    the loudspeaker, None: no sound is played; output_lost: it is gone; listens_on: URL for voice
    agents; speaking: name of the stream being spoken; n_playout_underruns: how often sound to be
    played came too late, a stream's or the device's. arousal: of the voice that is shown, -1 to 1;
    mouth_closes: whether the lips meet, as observed in calibration, None: not observed. is_resting:
    torque is off after a long silence until a person speaks; expression: its settings (liveliness,
    target to look at, affect), by name.
    """

    sound: str | None = None
    recognizer: str | None = None
    fallback_level: int | None = None
    fallback_reasons: Sequence[str] = ()
    engine: str | None = None
    weights: str | None = None
    strategy: str | None = None
    settings: Mapping[str, float] = field(default_factory=dict)
    delay_ms: float | None = None
    hears: str | None = None
    moved_by: str | None = None
    units_shifted_ms: float | None = None
    words: Sequence[str] = ()
    word: int | None = None
    n_phonemes: int | None = None
    n_lost_sound_blocks: int | None = None
    output: str | None = None
    output_lost: bool | None = None
    listens_on: str | None = None
    speaking: str | None = None
    n_playout_underruns: int | None = None
    arousal: float | None = None
    mouth_closes: bool | None = None
    is_resting: bool | None = None
    expression: Mapping[str, float] = field(default_factory=dict)


#: Copied one by one, since `asdict` copies what they hold as well, in the loop of the servos.
_BRIDGE_NAMES = tuple(each.name for each in fields(BridgeSide))
_SPEECH_NAMES = tuple(each.name for each in fields(SpeechStatus))
#: Of a face that nobody speaks through.
SILENT = SpeechStatus()


@dataclass(frozen=True, slots=True)
class Status:
    """The status of the whole face at one moment; immutable."""

    bridge: BridgeSide
    speech: SpeechStatus = SILENT

    @property
    def troubles(self) -> Sequence[str]:
        """The servos' troubles, and a line for the recogniser while a lesser one is in use."""
        speech = self.speech
        if not speech.fallback_level:
            return self.bridge.troubles
        reasons = "; ".join(speech.fallback_reasons)
        return (*self.bridge.troubles, f"recogniser {speech.recognizer} in use: {reasons}")

    def as_dict(self) -> dict[str, Any]:
        """Return all fields for JSON, flat: those of the bridge, then those of the speech side."""
        values = {name: getattr(self.bridge, name) for name in _BRIDGE_NAMES}
        values["troubles"] = self.troubles
        values.update((name, getattr(self.speech, name)) for name in _SPEECH_NAMES)
        return values


def whole_status(bridge: Mapping[str, Any], speech: SpeechStatus | None) -> Status:
    """Return the status of a face from the fields of `BridgeSide` and the status of its speech.

    speech: None: the face has no speech side. Raises TypeError for a field that `BridgeSide` lacks:
    it would be missing in every answer.
    """
    return Status(BridgeSide(**bridge), speech or SILENT)
