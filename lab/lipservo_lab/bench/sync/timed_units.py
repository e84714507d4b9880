"""Phonemes with times that are wrong in usual ways, sent with a clip: what the mouth shows then.

The clip of `make run` is streamed at the pace of speech through the playout and the recogniser, on
a virtual clock; what counts is the phoneme that is shown when its sound is heard.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib import resources
from typing import Final

import numpy as np

from lipservo.runtime.motion_options import MotionOptions
from lipservo.runtime.speech.phoneme_sources import SpokenPhonemes
from lipservo.runtime.speech.speech import Delay
from lipservo_lab.corpus.alignment_cache import PHONEME_INDEX
from lipservo_lab.evaluation.recognition.recognition_scores import SLACK_FRAMES, Labels, Score
from lipsync.arrays import Array32
from lipsync.audio.file import read_speech
from lipsync.audio.playout import Playout
from lipsync.audio.playout_stream import PlayoutRequest, PlayoutStream
from lipsync.audio_block import BLOCK_S, SAMPLE_RATE_HZ
from lipsync.motion.finishing import BILABIALS
from lipsync.phoneme_files.reader import read_phonemes
from lipsync.phonemes import SILENCE, PhonemeEvent
from lipsync.recognition.recognizers import make_recognizer
from lipsync.spoken_text import SpokenText, SpokenUnit, UnitKind
from lipsync.text_to_speech.pronunciation import pronounced_units
from lipsync.timeline import PhonemeTimeline

#: Agents send pieces of this length.
_CHUNK: Final = round(0.02 * SAMPLE_RATE_HZ)
_TAIL_S: Final = 0.5
#: Scattered times are drawn so often; their rows are averaged, closures are the worst.
_DRAWS: Final = 3
#: Offset and drift are found by then.
_SETTLED_S: Final = 1.5
_CLIP_TEXT: Final = "welcome.txt"
_OTHER_TEXT: Final = (
    "Somebody placed a green umbrella beside the open window, and later every farmer was happy "
    "about the small blue boats that had come from the valley."
)


@dataclass(frozen=True, slots=True)
class Sent:
    """What a sender sends beside its sound: timed units, or a text; if neither, nothing.

    late_s: after the beginning of each message's sound; None: all before the sound. message_s:
    seconds of sound that one message covers; 0: each unit is sent alone. lead_in_s: silence before
    the clip in the sound, which the units' times ignore.
    """

    kind: UnitKind = "phoneme"
    events: Sequence[PhonemeEvent] = ()
    late_s: float | None = None
    message_s: float = 0.5
    text: str = ""
    lead_in_s: float = 0.0


def timed_figures(advance: Callable[[int, int], None]) -> list[dict[str, object]]:
    """Play the clip with each defect of what is sent beside it; return a row for each defect.

    right: share of speech frames with the right viseme; right_settled: the same from 1.5 s on.
    closures: P, B and M that were shown, of closures_spoken; false_closures: where none is spoken.
    """
    with resources.as_file(resources.files("lipservo.clips") / "welcome.flac") as clip:
        samples = read_speech(clip)
    with resources.as_file(resources.files(__package__ or "") / "welcome.TextGrid") as labels:
        spoken = read_phonemes(labels)
    cases = defects(spoken)
    rows = []
    for number, (name, variants) in enumerate(cases.items()):
        advance(number, len(cases))
        scores = [_score_shown(samples, spoken, each) for each in variants]
        rows.append(
            {
                "defect": name,
                "right": round(float(np.mean([each.right for each in scores])), 3),
                "right_settled": round(float(np.mean([each.right_settled for each in scores])), 3),
                "closures": min(each.n_closures for each in scores),
                "closures_spoken": sum(each.phoneme in BILABIALS for each in spoken),
                "false_closures": max(each.n_false for each in scores),
            }
        )
    return rows


def defects(spoken: Sequence[PhonemeEvent]) -> dict[str, list[Sent]]:
    """Return what is sent beside a sound with phonemes `spoken`, by the defect's name.

    Several entries of one defect are several random draws.
    """
    text = (resources.files("lipservo.clips") / _CLIP_TEXT).read_text("utf-8").strip()
    visemes: UnitKind = "viseme"
    rng = np.random.default_rng(0)
    rotated = [*spoken[len(spoken) // 2 :], *spoken[: len(spoken) // 2]]
    return {
        "nothing beside the sound": [Sent()],
        "true times": [Sent(events=spoken)],
        "200 ms late": [Sent(visemes, _move(spoken, lambda s: s + 0.2))],
        "100 ms early": [Sent(visemes, _move(spoken, lambda s: s - 0.1))],
        "jitter of 40 ms": [
            Sent(visemes, _move(spoken, lambda s: s + rng.normal(0.0, 0.04))) for _ in range(_DRAWS)
        ],
        "0.3 s late": [Sent(events=spoken, late_s=0.3, message_s=0.0)],
        "0.3 s late, by the half second": [Sent(events=spoken, late_s=0.3)],
        "3 % slow": [Sent(events=_move(spoken, lambda s: 1.03 * s))],
        "of another sentence": [Sent(events=_one_after_the_other(rotated))],
        "lead-in of 0.5 s": [Sent(events=spoken, lead_in_s=0.5)],
        "true text": [Sent("text", text=text)],
        "another text": [Sent("text", text=_OTHER_TEXT)],
    }


def _move(
    events: Sequence[PhonemeEvent], moved: Callable[[float], float]
) -> tuple[PhonemeEvent, ...]:
    """Return the events with beginnings moved by `move`, kept in order, and without ends.

    A unit without an end lasts until the next one.
    """
    starts_s = np.maximum.accumulate([max(0.0, moved(event.start_s)) for event in events])
    return tuple(
        replace(event, start_s=float(start_s), end_s=None)
        for event, start_s in zip(events, starts_s, strict=True)
    )


def _one_after_the_other(events: Sequence[PhonemeEvent]) -> tuple[PhonemeEvent, ...]:
    """Return the events one after the other from 0 on, each as long as before."""
    at_s, moved = 0.0, []
    for event in events:
        duration_s = (event.end_s or event.start_s) - event.start_s
        moved.append(replace(event, start_s=at_s, end_s=at_s + duration_s))
        at_s += duration_s
    return tuple(moved)


@dataclass(frozen=True, slots=True)
class _ShownScore:
    """right, right_settled: share of speech frames with the right viseme, and that from 1.5 s on.

    n_closures: P, B and M that were shown; n_false: closures shown where none is spoken.
    """

    right: float
    right_settled: float
    n_closures: int
    n_false: int


def _score_shown(samples: Array32, spoken: Sequence[PhonemeEvent], sent: Sent) -> _ShownScore:
    """Play the clip with `sent` beside its sound; return how right the phonemes shown are.

    samples: (n,), the clip at 16 kHz. spoken: its true phonemes.
    """
    n_lead_in = round(sent.lead_in_s / BLOCK_S)
    sound = np.concatenate((np.zeros(round(sent.lead_in_s * SAMPLE_RATE_HZ), np.float32), samples))
    n_frames = round(len(samples) / SAMPLE_RATE_HZ / BLOCK_S)
    shown, truth = (_play(sound, sent)[n_lead_in : n_lead_in + n_frames], _labels(spoken, n_frames))
    score, settled_score, first_settled = Score(), Score(), round(_SETTLED_S / BLOCK_S)
    score.add(shown, truth)
    settled_score.add(shown[first_settled:], truth[first_settled:])
    closed = np.isin(shown, [PHONEME_INDEX[phoneme] for phoneme in BILABIALS])
    hits = [
        closed[max(0, round(each.start_s / BLOCK_S) - SLACK_FRAMES) :][
            : round(((each.end_s or each.start_s) - each.start_s) / BLOCK_S) + 2 * SLACK_FRAMES
        ].any()
        for each in spoken
        if each.phoneme in BILABIALS
    ]
    right, right_settled = (each.figures()["viseme_speech"] for each in (score, settled_score))
    n_false = score.bilabials.n_reported - score.bilabials.n_true
    return _ShownScore(right, right_settled, int(np.count_nonzero(hits)), n_false)


def _play(sound: Array32, sent: Sent) -> Labels:
    """Play a sound as an agent's stream on a virtual clock; return the phoneme that is shown.

    Result: (n_frames,), the phoneme's number for each 10 ms of the sound.
    """
    recognizer = make_recognizer()
    delay = Delay(recognizer.latency_s, MotionOptions().style.lookahead_s)
    n_delay = round(delay.synthesis_s / BLOCK_S)
    playout, timeline = Playout(), PhonemeTimeline()
    source = SpokenPhonemes(playout, recognizer)
    stream = PlayoutStream("agent", SAMPLE_RATE_HZ, playout.output_rate_hz)
    playout.requests.append(PlayoutRequest("say", stream))
    messages = _messages(sent)
    n_frames = round(len(sound) / SAMPLE_RATE_HZ / BLOCK_S)
    shown = np.full(n_frames, PHONEME_INDEX[SILENCE])
    n_sent, began_s = 0, None
    for tick in range(n_frames + n_delay + round(_TAIL_S / BLOCK_S)):
        now_s = tick * BLOCK_S
        while messages and messages[0][0] <= now_s:
            spoken = messages.pop(0)[1]
            stream.tell(spoken, () if spoken.moves_mouth else pronounced_units(spoken))
        while n_sent < len(sound) and n_sent <= now_s * SAMPLE_RATE_HZ:
            stream.push(sound[n_sent : n_sent + _CHUNK])
            n_sent += _CHUNK
            if n_sent >= len(sound):
                stream.end()
        playout.advance(now_s)
        for update in source.updates(now_s):
            timeline.apply(update)
        if began_s is None and (found := playout.stream_at(max(0.0, now_s - 2 * BLOCK_S))):
            began_s = now_s - 2 * BLOCK_S - found[1]
        if began_s is not None:
            frame = tick - n_delay - round(began_s / BLOCK_S)
            event = timeline.event_at(now_s - n_delay * BLOCK_S + BLOCK_S / 2)
            if 0 <= frame < n_frames and event is not None:
                shown[frame] = PHONEME_INDEX[event.phoneme]
    return shown


def _messages(sent: Sent) -> list[tuple[float, SpokenText]]:
    """Return when each message is sent, s from the sound's beginning, and its units; in order."""
    if sent.text:
        return [(0.0, SpokenText("text", (SpokenUnit(sent.text),), SAMPLE_RATE_HZ))]
    if sent.late_s is None:
        return [(0.0, _as_units(sent.kind, sent.events))] if sent.events else []
    messages: dict[float, list[PhonemeEvent]] = {}
    for event in sent.events:
        message_s = sent.message_s
        begins_s = message_s * int(event.start_s / message_s) if message_s else event.start_s
        messages.setdefault(begins_s, []).append(event)
    return [
        (begins_s + sent.late_s, _as_units(sent.kind, events))
        for begins_s, events in messages.items()
    ]


def _as_units(kind: UnitKind, events: Sequence[PhonemeEvent]) -> SpokenText:
    def sample(time_s: float | None) -> int | None:
        return None if time_s is None else round(time_s * SAMPLE_RATE_HZ)

    units = (SpokenUnit(each.phoneme, sample(each.start_s), sample(each.end_s)) for each in events)
    return SpokenText(kind, tuple(units), SAMPLE_RATE_HZ)


def _labels(events: Sequence[PhonemeEvent], n_frames: int) -> Labels:
    labels = np.full(n_frames, PHONEME_INDEX[SILENCE])
    for event in events:
        end_frame = n_frames if event.end_s is None else round(event.end_s / BLOCK_S)
        labels[round(event.start_s / BLOCK_S) : end_frame] = PHONEME_INDEX[event.phoneme]
    return labels
