"""Head, eyes, lids and brows for a whole recorded line, as its face moves them live.

Since the whole line is known, the voice is compared with the loudness and pitch of all of it, not
of the part before; speech is over when its last phone is, not 0.3 s later; and the head follows
the voice no later than a human one.
"""

from collections.abc import Iterator, Sequence
from hashlib import sha256
from itertools import chain, repeat
from typing import Final

import numpy as np
from numpy.typing import NDArray

from lipservo.runtime.servos.assembly import load_settings
from lipservo.runtime.speech.expression import expression_source
from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.expression.cue import CUE_PERIOD_S, ExpressionCue
from lipsync.offline.line_methods import Line
from lipsync.offline.performance import EXPRESSION_NAMES, RATE_HZ
from lipsync.phonemes import SILENCE, PhonemeEvent
from lipsync.prosody.voice_frame import SILENT_VOICE, VoiceFrame
from lipsync.prosody.voice_tracker import VoiceTracker

#: A live head's velocity follows loudness 50 ms late, with this 20 ms (eight lines of LibriSpeech);
#: a human one's 30 ms (docs/expression.md).
_LEAD_S: Final = 0.03
#: The generators run so long, in silence, before the line: it begins in the middle of a
#: conversation.
_BEFORE_S: Final = 3.0
#: A shorter pause is one within a sentence.
_PAUSE_S: Final = 0.3


def line_expression(face: str, line: Line, n_frames: int) -> dict[str, NDArray[np.float32]]:
    """Return the expression of a line over time; the same sound always gives the same expression.

    Parameters
    ----------
    face : str
        Name of a shipped face, or path of a YAML, with the settings of the expression.
    line : Line
        Sound and phones.
    n_frames : int
        Number of frames, 100 per second.

    Returns
    -------
    dict[str, NDArray[np.float32]]
        (n_frames,) each at i / 100 s of sound time, by the names `EXPRESSION_NAMES`.

    Raises
    ------
    SettingsError
        The face cannot be read.
    """
    settings, _ = load_settings(face)
    seed = settings.expression.seed ^ int.from_bytes(sha256(line.samples.tobytes()).digest()[:4])
    source = expression_source(settings.expression, seed)
    n_before = round(_BEFORE_S * RATE_HZ)
    voices = voice_frames(line.samples)[round(_LEAD_S * RATE_HZ) :]
    # The voice leads by 30 ms; before it and after it there is silence.
    line_voices = chain(repeat(SILENT_VOICE, n_before), voices, repeat(SILENT_VOICE))
    silences_s = chain(repeat(_PAUSE_S, n_before), silent_s(line.events, n_frames))
    shown = np.empty((n_frames, len(EXPRESSION_NAMES)), dtype=np.float32)
    for n, silence_s in enumerate(silences_s):
        voice = next(line_voices)
        cue = ExpressionCue(
            time_s=n * CUE_PERIOD_S,
            voice=voice,
            is_speaking=silence_s == 0.0,
            silent_s=silence_s,
            arousal=voice.arousal,
        )
        expression = source.step(cue)
        if n >= n_before:
            shown[n - n_before] = [getattr(expression, name) or 0.0 for name in EXPRESSION_NAMES]
    return dict(zip(EXPRESSION_NAMES, shown.T.copy(), strict=True))


def voice_frames(samples: NDArray[np.float32]) -> list[VoiceFrame]:
    """Return the prosody (loudness, pitch, arousal) of a sound, relative to that of all of it.

    Parameters
    ----------
    samples : NDArray[np.float32]
        (n,) at 16 kHz.

    Returns
    -------
    list[VoiceFrame]
        One for each 10 ms.
    """
    n_block = round(SAMPLE_RATE_HZ * CUE_PERIOD_S)
    tracker = VoiceTracker()
    for _ in range(2):  # the first time only to learn what is usual in this line
        frames = [
            tracker.feed(samples[at : at + n_block]) for at in range(0, len(samples), n_block)
        ]
    return frames


def silent_s(events: Sequence[PhonemeEvent], n_frames: int) -> Iterator[float]:
    """Yield for each 10 ms the seconds since speech ended, plus 0.3; 0 in speech and short pauses.

    A pause is short below 0.3 s. Before the first phone of `events` the seconds count from the
    start of the sound.
    """
    spoken = [event for event in events if event.phoneme != SILENCE]
    end_s = -np.inf  # of the phones so far
    later_events = iter(spoken)
    next_event = next(later_events, None)
    for n in range(n_frames):
        time_s = n / RATE_HZ
        while next_event is not None and next_event.start_s <= time_s:
            end_s = max(end_s, time_s if next_event.end_s is None else next_event.end_s)
            next_event = next(later_events, None)
        begins_s = np.inf if next_event is None else next_event.start_s
        if time_s < end_s or begins_s - end_s < _PAUSE_S:
            yield 0.0
        else:
            # As long as a hearer needs to take a silence for an end.
            yield _PAUSE_S + (time_s - end_s if np.isfinite(end_s) else time_s)
