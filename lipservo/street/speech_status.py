"""What the speech side says of itself."""

from collections.abc import Mapping
from typing import Final, Protocol

from lipservo.settings.motion_names import LIP_GAP_OFFSET
from lipservo.speech.speech import Speech
from lipservo.status.face_status import SpeechStatus
from lipservo.street.motion_options import MotionOptions
from lipsync.audio.playout import Playout
from lipsync.audio.source import AudioSource

#: Recognisers from the best down; each takes over where the one before it fails.
_LEVELS: Final = ("network", "energy", "neutral")
#: In place of who listens, of what it has learned and of the strategy, where all was rendered.
_NOBODY: Final = "none"
PERFORMED: Final = "performed"


class FallbackRecognizer(Protocol):
    """A recogniser that is replaced by a lesser one where it fails."""

    @property
    def level(self) -> str:
        """Who listens now, by name."""

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why each better one is not in use, the best first."""

    def take_changes(self) -> list[str]:
        """What changed since the last call: a line each, in order."""


def speech_status(
    options: MotionOptions,
    source: AudioSource,
    recognizer: FallbackRecognizer,
    speech: Speech,
    settings: Mapping[str, float],
    listens_on: str | None = None,
) -> SpeechStatus:
    """The speech side as it is now. settings: those that were changed since the start, by name."""
    playout = source if isinstance(source, Playout) else None
    output = None if playout is None else playout.loudspeaker
    expression = speech.expression
    asked = options.style_settings
    return SpeechStatus(
        sound=source.name,
        recognizer=_NOBODY if options.performed else recognizer.level,
        fallback_level=_levels_left(options, recognizer),
        fallback_reasons=recognizer.reasons,
        engine=_NOBODY if options.performed else options.engine,
        weights=_NOBODY if options.performed else options.weights,
        strategy=PERFORMED if options.performed else options.strategy,
        hears=speech.hears,
        settings={
            **{name: settings.get(name, value) for name, value in asked.items()},
            **({} if speech.lip_gap is None else {LIP_GAP_OFFSET: speech.lip_gap.wanted_mm}),
        },
        delay_ms=round(speech.delay.total_s * 1e3, 3),
        n_phonemes=speech.phonemes_planned,
        n_lost_sound_blocks=source.lost_blocks,
        output=None if output is None else output.name,
        output_lost=None if output is None else output.is_lost,
        listens_on=listens_on,
        speaking=None if playout is None else playout.speaking,
        n_playout_underruns=None if playout is None else playout.n_underruns,
        arousal=None if expression is None else round(expression.arousal, 3),
        is_resting=None if expression is None else expression.is_resting,
        expression={} if expression is None else expression.wishes.values,
    )


def _levels_left(options: MotionOptions, recognizer: FallbackRecognizer) -> int:
    if options.performed:
        return 0
    return _LEVELS.index(recognizer.level) - _LEVELS.index(options.engine)
