"""The status of a whole face: a record of the servos' side and one of the speech side, as one.

The terminal view, `--json`, `lipservo status` and the summary read it. What is not known at the
moment is None. docs/architecture.md has the same fields as a table, which a test keeps true.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any


@dataclass(frozen=True, slots=True)
class BridgeSide:
    """What the process knows that drives the servos, or the supervisor while there is none.

    name: of the face; config: its YAML, by the name of a shipped face or by its path; sounds: the
    folder whose sound files may be played; port: of its servos, None: simulated in memory; state:
    a `FaceState`, or what the supervisor does while no bridge runs; stopped: the stop of a person
    that holds, and stopped_by: who requested it; stop_report: what the servos reported of it
    (`StopReport`), None before they have; can_start: whether a person can start it now; plugged:
    whether the port is there; torque_on: whether a servo is driven; servos: the state of each, by
    name; troubles: a line for each servo that is not driven; jogged: joints that a person jogs;
    health: how each servo is, as `ServoHealth` has it, None for what was never heard; capabilities:
    what the bus can do (`BusCapabilities`); pulses: of each hobby servo, by name, its limits and
    what it was sent last; n_ticks to n_rejected_targets: the counts of `BridgeStatus`; *_total: how
    often the gate stepped in, over all servos; bridge_pid: the process that drives them.
    """

    name: str = ""
    config: str | None = None
    sounds: str | None = None
    port: str | None = None
    state: str = ""
    stopped: str | None = None
    stopped_by: str | None = None
    stop_report: Mapping[str, object] | None = None
    can_start: bool | None = None
    plugged: bool | None = None
    torque_on: bool | None = None
    servos: Mapping[str, str] = field(default_factory=dict)
    troubles: Sequence[str] = ()
    jogged: Sequence[str] = ()
    health: Sequence[Mapping[str, object]] = ()
    capabilities: Mapping[str, object] = field(default_factory=dict)
    pulses: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
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
    """What the speech side knows.

    sound: what is heard, by the name of file or device. recognizer: who listens now;
    fallback_level: how many better ones are not in use, 0: the best is;
    fallback_reasons: why each of them is not. engine, weights, strategy: as requested. settings:
    what the strategy lets its user set, as set last. hears: the class of the sound,
    `speech`, `noise` or `silence`; moved_by: what that is known from, `sound`, `text`, `words`,
    `phonemes` or `visemes`; words: those around the one that is spoken, as far as they are known,
    word: which of them that is. delay_ms: how much later than its sound the face is shown.
    n_phonemes: that moved the mouth; n_lost_sound_blocks: sound not heard. output: the
    loudspeaker, None: nothing is played; output_lost: it is gone; listens_on: where voice agents
    are waited for; speaking: the stream that is being spoken; n_playout_underruns: how often sound
    that was to be played was not there in time, a stream's or the device's. arousal: of the voice
    that is shown, -1 to 1; mouth_closes: whether its lips meet, as its
    calibration saw, None: not observed.
    is_resting: after a long silence its servos are let go until a person speaks; expression: how
    lively it is, where it looks and what affect was set, by name.
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
    """The whole face at one moment. Nothing in it changes afterwards."""

    bridge: BridgeSide
    speech: SpeechStatus = SILENT

    @property
    def troubles(self) -> Sequence[str]:
        """Those of the servos, and one while a lesser recogniser is in use."""
        speech = self.speech
        if not speech.fallback_level:
            return self.bridge.troubles
        reasons = "; ".join(speech.fallback_reasons)
        return (*self.bridge.troubles, f"recogniser {speech.recognizer} in use: {reasons}")

    def as_dict(self) -> dict[str, Any]:
        """For JSON, flat: first the fields of the bridge, then those of the speech side."""
        values = {name: getattr(self.bridge, name) for name in _BRIDGE_NAMES}
        values["troubles"] = self.troubles
        values.update((name, getattr(self.speech, name)) for name in _SPEECH_NAMES)
        return values


def whole_status(bridge: Mapping[str, Any], speech: SpeechStatus | None) -> Status:
    """The two sides as one. bridge: what `face_status` gives, and name and port of the face.

    Raises TypeError for a part that is not in `BridgeSide`: it would be missing in every answer.
    """
    return Status(BridgeSide(**bridge), speech or SILENT)
