"""`lipservo bench closures`: whether the mouth closes where P, B, M, F and V are spoken."""

from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lipservo.commands.options import Json, Model, Quiet, WeightsChoice
from lipservo.terminal.output import RESULTS, machine_class, print_json
from lipservo.terminal.progress_bar import progress_bar
from lipservo_lab.commands.bench.recognition import Cache, Limit, Speakers
from lipsync.motion.live_synthesizer import DEFAULT_LOOKAHEAD_S
from lipsync.recognition.network import LATENCY_S
from lipsync.recognition.weights import DEFAULT_WEIGHTS, find_weights

if TYPE_CHECKING:
    from lipservo_lab.evaluation.motion.lip_speed import LipSpeed
    from lipservo_lab.evaluation.recognition.closure_hits import Closure
    from lipsync.phonemes import PhonemeEvent


def closures(
    corpus: Annotated[
        Path | None,
        typer.Option(
            help="Folder as for `bench recognition`; without it the bundled clip.",
            show_default=False,
        ),
    ] = None,
    speakers: Speakers = "",
    limit: Limit = None,
    cache: Cache = None,
    lookahead_ms: Annotated[
        float, typer.Option(min=0.0, max=1000.0, help="As for `run`.")
    ] = DEFAULT_LOOKAHEAD_S * 1e3,
    latency_ms: Annotated[
        float, typer.Option(min=0.0, help="When a frame's label is due: 45, 95 or 145.")
    ] = LATENCY_S * 1e3,
    weights: WeightsChoice = DEFAULT_WEIGHTS,
    model: Model = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure at how many closures the mouth closes, by what the recogniser hears, and how fast.

    Where they are is told by forced alignment of what is said. Lips are watched at 100 Hz.
    """
    from lipservo_lab.evaluation.motion.lip_speed import lip_speed, lip_speed_figures
    from lipservo_lab.evaluation.recognition.closure_hits import closure_figures, closure_hits
    from lipservo_lab.evaluation.recognition.heard_motion import heard_motion
    from lipservo_lab.learning.motion.trained_model import load_trained_model
    from lipsync.recognition.network_recognizer import NetworkRecognizer

    recognizer = NetworkRecognizer(find_weights(weights), latency_ms / 1e3)
    face = load_trained_model(model)
    found: list[Closure] = []
    speeds: list[LipSpeed] = []

    def listen(sound: Path, phones: "tuple[PhonemeEvent, ...]") -> None:
        motion = heard_motion(sound, recognizer, face, lookahead_ms / 1e3)
        found.extend(closure_hits(motion, phones, face))
        speeds.append(lip_speed(face, motion.faces, motion.spoken_s))

    with progress_bar(quiet=quiet) as advance:
        if corpus is None:
            with resources.as_file(resources.files("lipservo.clips") / "welcome.flac") as clip:
                listen(clip, clip_phones(clip))
        else:
            from lipservo_lab.bench.aligned_corpus import aligned, selected

            utterances = selected(corpus, speakers, limit=limit)
            alignments = aligned(utterances, cache, None, advance)
            for number, utterance in enumerate(utterances, start=1):
                listen(utterance.sound, alignments[utterance.name].events())
                advance("closing", number, len(utterances))
    figures = {**closure_figures(found), **lip_speed_figures(speeds)}
    settings = {
        "weights": weights,
        "lookahead_ms": lookahead_ms,
        "latency_ms": latency_ms,
        "machine": machine_class(),
    }
    missed = [f"{c.phone.phoneme} at {c.phone.start_s:.2f} s" for c in found if not c.was_met]
    if corpus is None:
        figures["missed"] = missed
    if as_json:
        print_json({**figures, **settings})
        return
    for name, value in {**figures, **settings}.items():
        RESULTS.print(f"{name}: {value}", soft_wrap=True, highlight=False)


def clip_phones(clip: Path) -> "tuple[PhonemeEvent, ...]":
    """The bundled clip's phones, from its text."""
    from lipsync.recognition.alignment.forced_alignment import align
    from lipsync.recognition.speech_file import read_speech

    text = (resources.files("lipservo.clips") / "welcome.txt").read_text(encoding="utf-8")
    return align(read_speech(clip), text).phones
