"""`lipservo bench recognition` and `bench listening`: accuracy of a recogniser and its cost.

`lipservo bench texts`: how well `align` distinguishes spoken texts from others.

`lipservo bench voices`: how well the text of a synthesiser is followed in its sound.
"""

from functools import partial
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

import typer

from lipservo.commands.options import Json, MeasuredEngineChoice, Model, Quiet, WeightsChoice
from lipservo.terminal.output import MESSAGES, print_json, progress_bar
from lipservo_lab.commands.bench.printing import print_figures, print_table, with_machine
from lipservo_lab.commands.options import Cache, LatencyMs, Limit, Speakers, TextCorpus
from lipservo_lab.commands.work_bars import work_bars
from lipservo_lab.counted_progress import counting
from lipsync.recognition.network import DEFAULT_WEIGHTS, find_weights


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
        count = counting(advance, "listening", len(utterances))
        texts = known_texts(utterances, text)
        figures = measure(
            utterances, alignments, make, condition, count, groups_of, lambda u: texts[u.name]
        ).as_dict()
        if text == "another":
            count = counting(advance, "leaving", len(utterances))
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
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure the processor time of an audio block, and how late the mouth closes.

    The latter, counted from the end of a voice, needs --corpus.
    """
    import numpy as np

    from lipservo_lab.bench.hearing.recognizer_bench import aligned, measured_recognizer, selected
    from lipservo_lab.evaluation.recognition.benchmark import block_costs_s
    from lipsync.audio.file import read_speech

    utterances = None if corpus is None else selected(corpus, speakers, limit=limit)
    recognizer = measured_recognizer(engine, latency_ms / 1e3, weights)()
    with resources.as_file(resources.files("lipservo.clips") / "welcome.flac") as clip:
        speech = read_speech(clip)
    text = (resources.files("lipservo.clips") / "welcome.txt").read_text(encoding="utf-8")
    figures: dict[str, object] = {}
    for name, known in {"": "", "_with_text": text}.items():
        costs_s = block_costs_s(recognizer, speech, known)
        for percent in (50, 99):
            value_s = float(np.percentile(costs_s, percent))
            figures[f"block_ms_p{percent}_least_of_5{name}"] = 1e3 * value_s
    if utterances is not None:
        from lipservo_lab.evaluation.recognition.closing_times import ClosingBench, closing_figures
        from lipservo_lab.learning.motion.trained_model import load_trained_model
        from lipsync.motion.finishing import DEFAULT_LOOKAHEAD_S

        bench = ClosingBench(recognizer, load_trained_model(model), DEFAULT_LOOKAHEAD_S)
        with work_bars(quiet=quiet) as bars:
            alignments = aligned(utterances, cache, None, bars.advance)
            usable = [u for u in utterances if not alignments[u.name].error]
            recordings = (
                (read_speech(u.sound), alignments[u.name].phones)
                for u in bars.track("closing", usable)
            )
            figures |= closing_figures(bench, recordings, np.random.default_rng(0))
    print_figures({**figures, "engine": engine}, as_json=as_json)


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
    from lipservo_lab.bench.hearing.told_voices import (
        followed_voice,
        read_languages,
        sentences_of,
    )
    from lipsync.recognition.network_recognizer import NetworkRecognizer
    from lipsync.text_to_speech.synthesis import Voice

    texts = [each.text.lower() for each in selected(corpus, speakers, limit=limit)]
    make = partial(NetworkRecognizer, find_weights(weights))
    sentences_by = {}
    for each in filter(None, map(str.strip, spoken_by.split(","))):
        synthesizer, _, name = each.partition(":")
        voice = Voice(name) if synthesizer == "espeak" else Voice(name=name)
        sentences_by[f"{synthesizer}:{name}"] = synthesizer, [(text, voice) for text in texts]
    sentences_by |= {tag: ("espeak", sentences_of(tag)) for tag in read_languages(languages)}
    n_sentences = sum(len(sentences) for _, sentences in sentences_by.values())
    figures: dict[str, dict[str, float]] = {}
    with progress_bar(quiet=quiet) as advance:
        count = counting(advance, "speaking", n_sentences)
        for label, (synthesizer, sentences) in sentences_by.items():
            figures[label] = followed_voice(
                synthesizer, sentences, make, tells=not heard, progress=count
            ).figures()
    if as_json:
        settings = {"told": not heard, "weights": weights}
        print_json(with_machine({"voices": figures, "sentences": len(texts), **settings}))
        return
    print_table([{"voice": name, **row} for name, row in figures.items()], _VOICE_HEADINGS)
