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
    """Units that are sent with the sound, or a text; before it, or `late_s` after each message's.

    message_s: of the sound of one message; 0: each unit is sent alone. lead_in_s: silence that the
    sound has before the clip, of which the units' times know nothing.
    """

    kind: UnitKind = "phoneme"
    events: Sequence[PhonemeEvent] = ()
    late_s: float | None = None
    message_s: float = 0.5
    text: str = ""
    lead_in_s: float = 0.0


def timed_figures(advance: Callable[[int, int], None]) -> list[dict[str, object]]:
    """Return a row for each defect of what a sender says of its sound.

    Shares of right speech frames, P B M closed, and false closures. right_settled: the share from
    1.5 s on. closures_spoken: P B M of the clip.
    """
    with resources.as_file(resources.files("lipservo.clips") / "welcome.flac") as clip:
        samples = read_speech(clip)
    with resources.as_file(resources.files(__package__ or "") / "welcome.TextGrid") as labels:
        spoken = read_phonemes(labels)
    cases = defects(spoken)
    rows = []
    for number, (name, sent) in enumerate(cases.items()):
        advance(number, len(cases))
        scores = [_scored(samples, spoken, each) for each in sent]
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
    """Return what is sent beside a sound with phonemes `spoken`, by what is wrong with it.

    Several entries are several draws of the same defect.
    """
    text = (resources.files("lipservo.clips") / _CLIP_TEXT).read_text("utf-8").strip()
    visemes: UnitKind = "viseme"
    rng = np.random.default_rng(0)
    other = [*spoken[len(spoken) // 2 :], *spoken[: len(spoken) // 2]]
    return {
        "nothing beside the sound": [Sent()],
        "true times": [Sent(events=spoken)],
        "200 ms late": [Sent(visemes, _at(spoken, lambda s: s + 0.2))],
        "100 ms early": [Sent(visemes, _at(spoken, lambda s: s - 0.1))],
        "jitter of 40 ms": [
            Sent(visemes, _at(spoken, lambda s: s + rng.normal(0.0, 0.04))) for _ in range(_DRAWS)
        ],
        "0.3 s late": [Sent(events=spoken, late_s=0.3, message_s=0.0)],
        "0.3 s late, by the half second": [Sent(events=spoken, late_s=0.3)],
        "3 % slow": [Sent(events=_at(spoken, lambda s: 1.03 * s))],
        "of another sentence": [Sent(events=_one_after_the_other(other))],
        "lead-in of 0.5 s": [Sent(events=spoken, lead_in_s=0.5)],
        "true text": [Sent("text", text=text)],
        "another text": [Sent("text", text=_OTHER_TEXT)],
    }


def _at(
    events: Sequence[PhonemeEvent], moved: Callable[[float], float]
) -> tuple[PhonemeEvent, ...]:
    """The events at other times, in order, without ends: a unit lasts until the next one."""
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
class _Scored:
    """Right frames of speech, and from 1.5 s on; P B M that were closed; closures where none is."""

    right: float
    right_settled: float
    n_closures: int
    n_false: int


def _scored(samples: Array32, spoken: Sequence[PhonemeEvent], sent: Sent) -> _Scored:
    """Return how right the phonemes are that the clip shows, with `sent` beside its sound."""
    n_led = round(sent.lead_in_s / BLOCK_S)
    sound = np.concatenate((np.zeros(round(sent.lead_in_s * SAMPLE_RATE_HZ), np.float32), samples))
    n_frames = round(len(samples) / SAMPLE_RATE_HZ / BLOCK_S)
    shown, truth = _shown(sound, sent)[n_led : n_led + n_frames], _labels(spoken, n_frames)
    whole, late, first = Score(), Score(), round(_SETTLED_S / BLOCK_S)
    whole.add(shown, truth)
    late.add(shown[first:], truth[first:])
    closed = np.isin(shown, [PHONEME_INDEX[phoneme] for phoneme in BILABIALS])
    hits = [
        closed[max(0, round(each.start_s / BLOCK_S) - SLACK_FRAMES) :][
            : round(((each.end_s or each.start_s) - each.start_s) / BLOCK_S) + 2 * SLACK_FRAMES
        ].any()
        for each in spoken
        if each.phoneme in BILABIALS
    ]
    right, right_late = (each.figures()["viseme_speech"] for each in (whole, late))
    n_false = whole.bilabials.n_reported - whole.bilabials.n_true
    return _Scored(right, right_late, int(np.count_nonzero(hits)), n_false)


def _shown(sound: Array32, sent: Sent) -> Labels:
    """Play a sound as an agent's stream; return the phoneme number shown for each 10 ms."""
    recognizer = make_recognizer()
    delay = Delay(recognizer.latency_s, MotionOptions().style.lookahead_s)
    n_late = round(delay.synthesis_s / BLOCK_S)
    playout, timeline = Playout(), PhonemeTimeline()
    source = SpokenPhonemes(playout, recognizer)
    stream = PlayoutStream("agent", SAMPLE_RATE_HZ, playout.output_rate_hz)
    playout.requests.append(PlayoutRequest("say", stream))
    messages = _messages(sent)
    n_frames = round(len(sound) / SAMPLE_RATE_HZ / BLOCK_S)
    shown = np.full(n_frames, PHONEME_INDEX[SILENCE])
    n_sent, began_s = 0, None
    for tick in range(n_frames + n_late + round(_TAIL_S / BLOCK_S)):
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
            frame = tick - n_late - round(began_s / BLOCK_S)
            event = timeline.event_at(now_s - n_late * BLOCK_S + BLOCK_S / 2)
            if 0 <= frame < n_frames and event is not None:
                shown[frame] = PHONEME_INDEX[event.phoneme]
    return shown


def _messages(sent: Sent) -> list[tuple[float, SpokenText]]:
    """Return when each message is sent, s, and the units in it, in order."""
    if sent.text:
        return [(0.0, SpokenText("text", (SpokenUnit(sent.text),), SAMPLE_RATE_HZ))]
    if sent.late_s is None:
        return [(0.0, _spoken_text(sent.kind, sent.events))] if sent.events else []
    messages: dict[float, list[PhonemeEvent]] = {}
    for event in sent.events:
        step_s = sent.message_s
        begins_s = step_s * int(event.start_s / step_s) if step_s else event.start_s
        messages.setdefault(begins_s, []).append(event)
    return [
        (begins_s + sent.late_s, _spoken_text(sent.kind, events))
        for begins_s, events in messages.items()
    ]


def _spoken_text(kind: UnitKind, events: Sequence[PhonemeEvent]) -> SpokenText:
    def sample(time_s: float | None) -> int | None:
        return None if time_s is None else round(time_s * SAMPLE_RATE_HZ)

    units = (SpokenUnit(each.phoneme, sample(each.start_s), sample(each.end_s)) for each in events)
    return SpokenText(kind, tuple(units), SAMPLE_RATE_HZ)


def _labels(events: Sequence[PhonemeEvent], n_frames: int) -> Labels:
    labels = np.full(n_frames, PHONEME_INDEX[SILENCE])
    for event in events:
        end = n_frames if event.end_s is None else round(event.end_s / BLOCK_S)
        labels[round(event.start_s / BLOCK_S) : end] = PHONEME_INDEX[event.phoneme]
    return labels
