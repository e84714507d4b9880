"""`lipservo bench closures`: whether the mouth closes where P, B, M, F and V are spoken.

`lipservo bench microphone`: sooner or more right, so that a puppeteer can choose.

`lipservo bench nonspeech`: how long the mouth opens for sounds that are no speech.

`lipservo bench ladder`: how a face recognises while other programs take the computer.
"""

import tempfile
import time
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lipservo.commands.options import EngineChoice, Json, Model, Quiet, WeightsChoice
from lipservo.terminal.output import MESSAGES, print_json, progress_bar
from lipservo_lab.commands.bench.printing import print_figures, print_table, with_machine
from lipservo_lab.commands.options import Cache, Limit, Speakers, TextCorpusOrClip
from lipsync.errors import UserError
from lipsync.motion.finishing import DEFAULT_LOOKAHEAD_S
from lipsync.recognition.network import DEFAULT_WEIGHTS, LATENCY_S, check_weights, find_weights

if TYPE_CHECKING:
    from lipservo_lab.bench.sync.microphone_latency import Recording
    from lipservo_lab.evaluation.motion.measures import LipSpeed
    from lipservo_lab.evaluation.recognition.heard_motion import Closure
    from lipsync.phonemes import PhonemeEvent


def closures(
    corpus: TextCorpusOrClip = None,
    speakers: Speakers = "",
    limit: Limit = None,
    cache: Cache = None,
    lookahead_ms: Annotated[
        float, typer.Option(min=0.0, max=1000.0, help="Following sound the motion may use, ms.")
    ] = DEFAULT_LOOKAHEAD_S * 1e3,
    latency_ms: Annotated[
        float, typer.Option(min=0.0, help="Recogniser's delay, ms: 45, 95 or 145.")
    ] = LATENCY_S * 1e3,
    weights: WeightsChoice = DEFAULT_WEIGHTS,
    model: Model = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure how often and how fast the mouth closes at P, B, M, F, V, by recognised phonemes.

    Forced alignment of the text gives the times of these sounds. The lips are sampled at 100 Hz.
    """
    from lipservo_lab.evaluation.motion.measures import lip_speed, lip_speed_figures
    from lipservo_lab.evaluation.recognition.heard_motion import (
        closure_figures,
        closure_hits,
        heard_motion,
    )
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
            from lipservo_lab.bench.hearing.recognizer_bench import aligned, selected

            utterances = selected(corpus, speakers, limit=limit)
            alignments = aligned(utterances, cache, None, advance)
            for number, utterance in enumerate(utterances, start=1):
                listen(utterance.sound, alignments[utterance.name].events())
                advance("closing", number, len(utterances))
    figures = {**closure_figures(found), **lip_speed_figures(speeds)}
    missed = [f"{c.phone.phoneme} at {c.phone.start_s:.2f} s" for c in found if not c.is_reached]
    if corpus is None:
        figures["missed"] = missed
    settings = {"weights": weights, "lookahead_ms": lookahead_ms, "latency_ms": latency_ms}
    print_figures({**figures, **settings}, as_json=as_json)


def clip_phones(clip: Path) -> "tuple[PhonemeEvent, ...]":
    """Align the bundled clip with its text; return its phones."""
    from lipsync.audio.file import read_speech
    from lipsync.recognition.alignment import align

    text = (resources.files("lipservo.clips") / "welcome.txt").read_text(encoding="utf-8")
    return align(read_speech(clip), text).phones


#: The figures of a row, and their headings.
_COLUMNS = {
    "lookahead_ms": "look-ahead, ms",
    "latency_ms": "recogniser, ms",
    "declared_delay_ms": "declared delay, ms",
    "microphone_to_bus_p95_ms": "microphone to bus, p95, ms",
    "closure_hits": "P B M met",
    "labiodental_hits": "F V met",
    "viseme_all": "visemes, all",
    "viseme_speech": "visemes, speech",
}


def microphone(
    corpus: TextCorpusOrClip = None,
    speakers: Speakers = "",
    limit: Limit = None,
    cache: Cache = None,
    weights: WeightsChoice = DEFAULT_WEIGHTS,
    model: Model = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure delay, closures and accuracy for several look-aheads and recogniser delays.

    Delay counts from the microphone to the first goal on the bus, on a virtual clock with simulated
    servos. Accuracy needs --corpus.
    """
    from lipservo_lab.bench.hearing.recognizer_bench import aligned, selected
    from lipservo_lab.bench.sync.microphone_latency import microphone_table
    from lipservo_lab.evaluation.recognition.benchmark import measure
    from lipservo_lab.learning.motion.trained_model import load_trained_model
    from lipsync.recognition.network_recognizer import NetworkRecognizer

    face = load_trained_model(model)
    learned = find_weights(weights)
    with progress_bar(quiet=quiet) as advance:
        if corpus is None:
            with resources.as_file(resources.files("lipservo.clips") / "welcome.flac") as clip:
                recordings: list[Recording] = [(clip, clip_phones(clip))]
                rows = microphone_table(recordings, face, weights, lambda _: {}, advance)
        else:
            utterances = selected(corpus, speakers, limit=limit)
            alignments = aligned(utterances, cache, None, advance)

            def accuracy(latency_s: float) -> Mapping[str, object]:
                found = measure(
                    utterances, alignments, lambda: NetworkRecognizer(learned, latency_s)
                ).score.figures()
                return {name: found[name] for name in ("viseme_all", "viseme_speech")}

            recordings = [(u.sound, alignments[u.name].events()) for u in utterances]
            rows = microphone_table(recordings, face, weights, accuracy, advance)
    if as_json:
        print_json(with_machine({"rows": rows, "weights": weights}))
        return
    print_table(rows, {name: head for name, head in _COLUMNS.items() if name in rows[0]})


#: What is printed of a folder's sounds.
_OPENINGS = {
    "folder": "folder",
    "open_share": "open",
    "speech_share": "speech",
    "openings_per_min": "openings/min",
    "widest_mm": "widest mm",
    "files": "files",
    "seconds": "s",
}


def nonspeech(
    folder: Annotated[
        Path, typer.Argument(help="Folder of sound files without speech, with subfolders.")
    ],
    engine: EngineChoice = "network",
    weights: WeightsChoice = DEFAULT_WEIGHTS,
    model: Model = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure how often, how long and how wide the mouth opens while there is no speech.

    Recogniser and default motion run as they do live. Each subfolder of FOLDER is one kind of
    sound, and has a line of its own. Files that are no sound are listed and left out.
    """
    from lipservo_lab.evaluation.recognition.nonspeech_answers import nonspeech_folder, sound_files
    from lipservo_lab.learning.motion.trained_model import load_trained_model
    from lipsync.recognition.recognizers import make_recognizer

    check_weights(weights)
    files = sound_files(folder)
    recognizer = make_recognizer(engine, weights=weights)
    with progress_bar(quiet=quiet) as advance:
        found = nonspeech_folder(
            folder,
            files,
            recognizer,
            load_trained_model(model),
            DEFAULT_LOOKAHEAD_S,
            lambda n: advance("listening", n, len(files)),
        )
    for line in found.not_sound:
        MESSAGES.print(f"left out: {line}", soft_wrap=True)
    if recognizer.reasons:
        raise UserError(f"the recogniser failed: {'; '.join(recognizer.reasons)}")
    settings = {
        "engine": engine,
        "weights": weights,
        "lookahead_ms": DEFAULT_LOOKAHEAD_S * 1e3,
    }
    if as_json:
        print_json(with_machine({**found.as_dict(), **settings}))
        return
    folders = {"all": found.figures(), **found.figures_by_folder()}
    print_table([{"folder": name, **row} for name, row in folders.items()], _OPENINGS)


def ladder(
    minutes: Annotated[
        float, typer.Option(min=0.8, max=600.0, help="Minutes that the face listens.")
    ] = 10.0,
    programs: Annotated[
        int, typer.Option(min=1, max=64, help="Busy programs for each processor core.")
    ] = 2,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure which recogniser a face runs while every core is busy for 1, 2 and 5 s a minute.

    The face is a whole `lipservo run` in real time. The command also measures how soon the loudness
    recogniser replaces a recogniser that takes ten times as long as its sound.
    """
    from firmware_bridge.stop_signals import SignalCounter
    from lipservo_lab.bench.hearing.ladder_figures import ladder_figures

    began_s = time.perf_counter()
    with (
        tempfile.TemporaryDirectory(prefix="ladder-") as folder,
        progress_bar(quiet=quiet or as_json) as advance,
        SignalCounter() as signals,
    ):
        figures = ladder_figures(
            minutes,
            programs,
            Path(folder),
            lambda done_s, whole_s: advance("listening", round(done_s), round(whole_s)),
            lambda: signals.count > 0,
        )
    load = {"minutes": minutes, "programs_per_core": programs}
    print_figures({**figures, **load}, as_json=as_json, began_s=began_s)
