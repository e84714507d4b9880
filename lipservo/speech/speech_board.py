"""What the speech side tells whoever watches, once a tick."""

from lipservo.speech.speech import Speech
from lipservo.status.live_board import MOST_PEAKS, LiveBoard, expression_values
from lipsync.arrays import Array
from lipsync.phonemes import PHONEMES


class SpeechBoard:
    """Writes to a `LiveBoard` what is shown."""

    def __init__(self, board: LiveBoard, rest: Array) -> None:
        """rest: the face (n_components,) of a mouth at rest."""
        self._board = board
        self._rest = rest
        self._numbers = {phoneme: number for number, phoneme in enumerate(PHONEMES)}
        self._told_s = 0.0

    def tell(self, now_s: float, speech: Speech) -> None:
        """What is shown at monotonic `now_s`."""
        sound_s = speech.sound_time_s(now_s)
        phoneme, frame = speech.shown_at(max(0.0, sound_s))
        expression = speech.expression
        is_cut_off = speech.is_cut_off
        heard = None if expression is None else expression.voice
        self._board.write_speech(
            [] if heard is None else heard.peaks(self._told_s, sound_s, MOST_PEAKS),
            time_s=now_s,
            sound_s=sound_s,
            phoneme=self._numbers[phoneme],
            is_cut_off=is_cut_off,
            is_speech=heard is not None and heard.at(sound_s).is_speech,
            arousal=0.0 if expression is None else expression.arousal,
            coefficients=self._rest if is_cut_off else frame.coefficients,
            expression=expression_values()
            if expression is None
            else expression_values(expression.expression),
        )
        self._told_s = max(self._told_s, sound_s)
