"""`lipservo bench recognition` and `bench listening`: accuracy of a recogniser and its cost.

`lipservo bench texts`: how well `align` distinguishes spoken texts from others.

`lipservo bench languages`: closures and openings heard in other languages than English.

`lipservo bench voices`: how well the text of a synthesiser is followed in its sound.
"""

import itertools
import tempfile
from collections.abc import Iterator, Sequence
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal, TypeVar

import typer

from lipservo.commands.options import Json, MeasuredEngineChoice, Model, Quiet, WeightsChoice
from lipservo.terminal.output import MESSAGES, Advance, print_json, progress_bar
from lipservo_lab.commands.bench.printing import print_figures, print_table, with_machine
from lipservo_lab.commands.options import Cache, LatencyMs, Limit, Speakers, TextCorpus
from lipsync.recognition.network import DEFAULT_WEIGHTS, find_weights

_Item = TypeVar("_Item")


def recognition(
    corpus: TextCorpus,
    speakers: Speakers = "",
    only: Annotated[
        str | None,
        typer.Option(
            metavar="FILE[:KEY]",
            help="Utterances to use: a text file of names, one a line, or FILE.json:KEY.",
        ),
    ] = None,
    limit: Limit = None,
    latency_ms: LatencyMs = 95.0,
    engine: MeasuredEngineChoice = "network",
    noise: Annotated[
        str | None,
        typer.Option(
            metavar="KIND:DB",
            help="Disturb the sound: white, music, babble or servos (DB: signal to noise); level "
            "(DB: change); telephone or clipped (no DB); room (instead of DB: metres).",
        ),
    ] = None,
    servo_speeds: Annotated[
        bool,
        typer.Option(
            "--servo-speeds", help="With --noise servos:DB: tell the recogniser the servos' speeds."
        ),
    ] = False,
    text: Annotated[
        Literal["own", "another"] | None,
        typer.Option(
            help="own: give the recogniser the utterance's text; another: give it another "
            "utterance's text, and measure how soon it is dropped."
        ),
    ] = None,
    by: Annotated[
        Literal["speaker", "group"] | None,
        typer.Option(help="Also print figures of each speaker, or of each group in --groups."),
    ] = None,
    groups: Annotated[
        Path | None,
        typer.Option(
            help="Table of speakers (speaker,group,gender); default: speakers.csv of the corpus."
        ),
    ] = None,
    cache: Cache = None,
    yardstick: Annotated[
        Path | None,
        typer.Option(
            help="File of hashes of the reference alignments: alignments that have changed since "
            "are listed, new ones are added."
        ),
    ] = None,
    weights: WeightsChoice = DEFAULT_WEIGHTS,
    jobs: Annotated[int | None, typer.Option(min=1, help="Number of processes that align.")] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure how right a live recogniser is, against the corpus's texts, aligned with the sound.

    --noise: white:10 is white noise 10 dB below the speech; level:-20 lowers the sound by 20 dB;
    room:2 is a talker at 2 m in a room. --by group needs a table of speakers (--groups).
    """
    from lipservo_lab.bench.hearing.recognizer_bench import (
        aligned,
        known_texts,
        measured_recognizer,
        selected,
        speaker_groups,
    )
    from lipservo_lab.corpus.scored_alignments import fix_alignments
    from lipservo_lab.evaluation.recognition.benchmark import leaving_figures, measure
    from lipservo_lab.evaluation.recognition.conditions import parse_condition

    condition = None
    if noise is not None or servo_speeds:
        condition = parse_condition(noise or "", tells_servos=servo_speeds)
    make = measured_recognizer(engine, latency_ms / 1e3, weights)
    utterances = selected(corpus, speakers, only, limit)
    groups_of = speaker_groups(by, corpus, groups)
    with progress_bar(quiet=quiet) as advance:
        alignments = aligned(utterances, cache, jobs, advance)
        heard: list[str] = []

        def count(name: str) -> None:
            heard.append(name)
            advance("listening", len(heard), len(utterances))

        texts = known_texts(utterances, text)
        figures = measure(
            utterances, alignments, make, condition, count, groups_of, lambda u: texts[u.name]
        ).as_dict()
        if text == "another":
            heard.clear()
            figures |= leaving_figures(utterances, alignments, make, count)
    if yardstick is not None:
        names = fix_alignments(yardstick, alignments.values())
        figures["alignments_moved"] = len(names)
        for name in names:
            MESSAGES.print(f"alignment is not that of --yardstick: {name}", soft_wrap=True)
    if not as_json:
        del figures["visible_error_table"]
    for utterance in alignments.values():
        if utterance.error:
            MESSAGES.print(f"not aligned: {utterance.name}: {utterance.error}", soft_wrap=True)
    settings = {
        "engine": engine,
        "weights": weights,
        "latency_ms": latency_ms,
        "noise": noise,
        "servo_speeds": servo_speeds,
        "text": text,
    }
    print_figures({**figures, **settings}, as_json=as_json)


def listening(
    engine: MeasuredEngineChoice = "network",
    latency_ms: LatencyMs = 95.0,
    weights: WeightsChoice = DEFAULT_WEIGHTS,
    corpus: Annotated[
        Path | None,
        typer.Option(
            help="Recordings with texts (docs/recognition.md, Corpora) on which to measure delays "
            "of the mouth too."
        ),
    ] = None,
    speakers: Speakers = "",
    limit: Limit = None,
    cache: Cache = None,
    model: Model = None,
    hours: Annotated[
        float, typer.Option(min=0.0, help="Hours of speech without a pause to recognise as well.")
    ] = 0.0,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure phonemes found in silence, processor time of an audio block, delays of the mouth.

    The delays need --corpus: how late the mouth closes when a voice stops, and how soon it leaves
    rest when a voice starts.
    """
    import numpy as np

    from lipservo_lab.bench.hearing.recognizer_bench import measured_recognizer
    from lipservo_lab.evaluation.recognition.benchmark import (
        block_costs_s,
        false_speech,
        own_servo_figures,
        quiet_sounds,
    )
    from lipsync.audio.file import read_speech

    utterances = None
    if corpus is not None:
        from lipservo_lab.bench.hearing.recognizer_bench import aligned, selected

        utterances = selected(corpus, speakers, limit=limit)
    recognizer = measured_recognizer(engine, latency_ms / 1e3, weights)()
    figures: dict[str, object] = {
        f"false_speech_{name}": false_speech(recognizer, sound)
        for name, sound in quiet_sounds(np.random.default_rng(0)).items()
    }
    figures |= own_servo_figures(measured_recognizer(engine, latency_ms / 1e3, weights))
    with resources.as_file(resources.files("lipservo.clips") / "welcome.flac") as clip:
        speech = read_speech(clip)
    text = (resources.files("lipservo.clips") / "welcome.txt").read_text(encoding="utf-8")
    costs_s = {
        "": block_costs_s(recognizer, speech),
        "_with_text": block_costs_s(recognizer, speech, text),
    }
    for name, percent in itertools.product(costs_s, (50, 99)):
        value_s = float(np.percentile(costs_s[name], percent))
        figures[f"block_ms_p{percent}_least_of_5{name}"] = 1e3 * value_s
    if utterances is not None:
        from lipservo_lab.evaluation.recognition.closing_times import (
            ClosingBench,
            closing_figures,
            waking_figures,
        )
        from lipservo_lab.learning.motion.trained_model import load_trained_model
        from lipsync.motion.finishing import DEFAULT_LOOKAHEAD_S

        bench = ClosingBench(recognizer, load_trained_model(model), DEFAULT_LOOKAHEAD_S)
        with progress_bar(quiet=quiet) as advance:
            alignments = aligned(utterances, cache, None, advance)
            usable = [u for u in utterances if not alignments[u.name].error]
            for what, measured in (("closing", closing_figures), ("waking", waking_figures)):
                recordings = (
                    (read_speech(u.sound), alignments[u.name].phones)
                    for u in _counted(usable, what, advance)
                )
                figures |= measured(bench, recordings, np.random.default_rng(0))
    if hours > 0.0:
        from lipservo.runtime.summary import resident_mb
        from lipservo_lab.evaluation.recognition.stream_observers import endure, without_pauses

        speech = without_pauses(recognizer, speech)
        with progress_bar(quiet=quiet) as advance:
            endured = endure(
                recognizer,
                speech,
                hours * 3600.0,
                resident_mb,
                lambda done, whole: advance("enduring", done, whole),
            )
        figures |= endured.as_dict()
    print_figures({**figures, "engine": engine}, as_json=as_json)


def _counted(items: Sequence[_Item], what: str, advance: Advance) -> Iterator[_Item]:
    """The items one after the other, on a progress bar."""
    for number, item in enumerate(items):
        advance(what, number, len(items))
        yield item
    advance(what, len(items), len(items))


def texts(
    corpus: TextCorpus,
    speakers: Speakers = "",
    limit: Limit = None,
    weights: WeightsChoice = DEFAULT_WEIGHTS,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure how often `lines align` accepts, doubts or refuses true and false texts.

    Each recording is aligned with its own text and with wrong ones.
    """
    from lipservo_lab.bench.hearing.recognizer_bench import selected
    from lipservo_lab.evaluation.recognition.benchmark import score_texts, text_figures

    utterances = selected(corpus, speakers, limit=limit)
    learned = find_weights(weights)
    scores = []
    with progress_bar(quiet=quiet) as advance:
        for number, each in enumerate(score_texts(utterances, learned), start=1):
            scores.append(each)
            advance("aligning", number, len(utterances))
    print_figures({**text_figures(scores), "weights": weights}, as_json=as_json)


#: What is printed of a language.
_LANGUAGE_HEADINGS = {
    "language": "language",
    "closure_recall": "closure recall",
    "closure_precision": "closure precision",
    "opening_recall": "opening recall",
    "opening_precision": "opening precision",
    "viseme_speech": "visemes of speech",
}


def languages(
    languages: Annotated[
        str, typer.Option(help="Languages: de,fr,es,pt,zh,ja; default: all.", show_default=False)
    ] = "",
    engine: MeasuredEngineChoice = "network",
    latency_ms: LatencyMs = 95.0,
    weights: WeightsChoice = DEFAULT_WEIGHTS,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure how well the recogniser works for other languages, spoken by espeak-ng.

    There are ten sentences of each language; espeak-ng's own phoneme times are the truth. Phonemes
    that English lacks count as the English ones that look alike on the lips.
    """
    from lipservo_lab.bench.hearing.recognizer_bench import measured_recognizer
    from lipservo_lab.bench.hearing.spoken_languages import (
        language_scores,
        language_sentences,
        read_languages,
    )

    chosen = read_languages(languages)
    make = measured_recognizer(engine, latency_ms / 1e3, weights)
    n_sentences = sum(len(language_sentences()[tag]) for tag in chosen)
    n_done = 0
    with progress_bar(quiet=quiet) as advance, tempfile.TemporaryDirectory() as folder:

        def count() -> None:
            nonlocal n_done
            n_done += 1
            advance("speaking", n_done, n_sentences)

        scores = language_scores(chosen, make, Path(folder), count)
    figures = {tag: score.figures() for tag, score in scores.items()}
    if as_json:
        settings = {"engine": engine, "weights": weights, "latency_ms": latency_ms}
        print_json(with_machine({"languages": figures, **settings}))
        return
    print_table([{"language": tag, **row} for tag, row in figures.items()], _LANGUAGE_HEADINGS)


#: What is printed of a voice.
_VOICE_HEADINGS = {
    "voice": "voice",
    "viseme_speech": "visemes",
    "per": "PER",
    "closure_recall": "P B M recall",
    "closure_precision": "and prec.",
    "boundary_ms_p50": "ms p50",
    "boundary_ms_p90": "ms p90",
    "closing_onset_ms_p50": "P B M ms",
    "found": "found",
}


def voices(
    corpus: Annotated[
        Path, typer.Option(help="Folder of texts to speak (docs/recognition.md, Corpora).")
    ],
    speakers: Speakers = "",
    limit: Limit = None,
    spoken_by: Annotated[
        str, typer.Option("--voices", help="Voices as SYNTHESISER:VOICE, commas between.")
    ] = "espeak:en-029,espeak:en-gb-scotland,flite:rms",
    languages: Annotated[
        str, typer.Option(help="Languages of espeak-ng to measure; default: de,fr,es,pt,zh,ja.")
    ] = "",
    heard: Annotated[
        bool, typer.Option("--heard", help="Do not give the recogniser the text.")
    ] = False,
    weights: WeightsChoice = DEFAULT_WEIGHTS,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure how exactly the phones of a known text are found in a synthesiser's voice.

    The synthesiser's own phoneme times are the truth. --voices: a voice of espeak is a language or
    accent (espeak:en-gb-scotland), one of flite or festival a speaker (flite:rms). --languages: in
    each, espeak-ng speaks ten sentences of its own. Closures are those of P, B and M; boundaries
    are the beginnings of the phones that were found.
    """
    from lipservo_lab.bench.hearing.recognizer_bench import selected
    from lipservo_lab.bench.hearing.spoken_languages import language_sentences, read_languages
    from lipservo_lab.bench.hearing.told_voices import followed_language, followed_voice
    from lipsync.recognition.network_recognizer import NetworkRecognizer
    from lipsync.text_to_speech.synthesis import Voice

    texts = [each.text.lower() for each in selected(corpus, speakers, limit=limit)]
    tags = read_languages(languages)
    learned = find_weights(weights)
    chosen = [each.strip().partition(":") for each in spoken_by.split(",") if each.strip()]
    n_sentences = len(texts) * len(chosen) + sum(len(language_sentences()[tag]) for tag in tags)
    n_done = 0
    figures: dict[str, dict[str, float]] = {}
    with progress_bar(quiet=quiet) as advance:

        def count() -> None:
            nonlocal n_done
            n_done += 1
            advance("speaking", n_done, n_sentences)

        def make() -> NetworkRecognizer:
            return NetworkRecognizer(learned)

        for synthesizer, _, name in chosen:
            voice = Voice(name) if synthesizer == "espeak" else Voice(name=name)
            figures[f"{synthesizer}:{name}"] = followed_voice(
                synthesizer, voice, texts, make, tells=not heard, progress=count
            ).figures()
        for tag in tags:
            figures[tag] = followed_language(tag, make, tells=not heard, progress=count).figures()
    if as_json:
        settings = {"told": not heard, "weights": weights}
        print_json(with_machine({"voices": figures, "sentences": len(texts), **settings}))
        return
    print_table([{"voice": name, **row} for name, row in figures.items()], _VOICE_HEADINGS)
