"""`lipservo bench`, `learn` and `study`: where each command of the lab is."""

from types import MappingProxyType

import typer

from lipservo.commands.lazy_group import Command, LazyGroup

_BENCH, _LEARN = "lipservo_lab.commands.bench", "lipservo_lab.commands.learn"
_STUDY = "lipservo_lab.commands.study.study"
#: Where each bench is, and its line in the help, by section.
_BENCHES = {
    "Motion": {
        "motion:motion": "Motion against recordings.",
        "readability:readability": "Words read off the mouth.",
        "motion:figures": "The paper's tables.",
        "closures:closures": "How often lips close.",
        "faces:sync": "Lips against their sound.",
        "bench:synthesis": "Speed of the motion.",
        "faces:line": "Serial lines that lose bytes.",
        "faces:shapes": "Mouth shapes for avatars.",
    },
    "Hearing": {
        "recognition:recognition": "Phonemes and visemes recognised.",
        "recognition:listening": "Cost of a block, delays of the mouth.",
        "closures:microphone": "Delay and closures at a microphone.",
        "closures:nonspeech": "Sounds that are no speech.",
        "recognition:voices": "Texts and languages in synthetic voices.",
        "recognition:texts": "Alignment of false texts.",
        "closures:ladder": "The recogniser on a busy computer.",
    },
    "Servos and stops": {
        "bench:bus": "The servo bus beside its rivals.",
        "bench:faults": "Faults, stops and signals.",
        "bench:endurance": "Many cycles of one face.",
        "bench:cost": "Cost of a face at rest.",
        "bench:fleet": "A hundred faces at once.",
        "bench:replay": "Speed of a replay.",
    },
    "Calibration, faces and pictures": {
        "bench:house": "Count the source's lines.",
        "bench:inputs": "Odd files and texts.",
        "bench:calibration": "Calibration of simulated robots.",
        "display:display": "Photographs and films that speak.",
        "faces:face": "Expression and dashboard.",
        "agents:agent": "What an agent remembers.",
        "agents:day": "An agent and a face all day.",
        "bench:cluster": "Rendering while workers are killed.",
        "faces:scans": "Registration of scans.",
        "bench:study": "Simulated raters of a study.",
    },
}


class BenchGroup(LazyGroup):
    """Each prints figures that the documentation gives."""

    prefix = "bench."

    table = MappingProxyType(
        {
            place.partition(":")[2]: Command(f"{_BENCH}.{place}", about, section)
            for section, benches in _BENCHES.items()
            for place, about in benches.items()
        }
    )


class LearnGroup(LazyGroup):
    """Each writes a model, or recordings that a model is learned from."""

    prefix = "learn."

    table = MappingProxyType(
        {
            "face": Command(f"{_LEARN}.training:train", "A face model from recordings."),
            "soft": Command(
                f"{_LEARN}.training:train_soft", "A face model fitted to a recogniser's weights."
            ),
            "recognizer": Command(f"{_LEARN}.recognizer:train_recognizer", "Train the recogniser."),
            "offline": Command(f"{_LEARN}.training:train_offline", "Train for `lines render`."),
            "adapt": Command(f"{_LEARN}.recognizer:adapt", "Recogniser weights for one voice."),
            "import-video": Command(
                f"{_LEARN}.imports:import_video", "Turn videos of a face into recordings."
            ),
            "import-scans": Command(f"{_LEARN}.imports:import_scans", "Recordings from scans."),
            "record": Command(
                f"{_LEARN}.record_corpus:record_corpus", "Record a reader with a camera."
            ),
            "plot": Command(f"{_LEARN}.recognizer:plot_training", "Draw the log of a training."),
        }
    )


class StudyGroup(LazyGroup):
    """A study with people, from its clips to its report."""

    prefix = "study."

    table = MappingProxyType(
        {
            "make": Command(f"{_STUDY}:make", "Film the clips of a study."),
            "serve": Command(f"{_STUDY}:serve", "Show a study to raters in a browser."),
            "report": Command(f"{_STUDY}:report", "Print the raters' results."),
            "recorded": Command(
                "lipservo_lab.commands.study.recorded:recorded",
                "Write a recorded sentence as a performance.",
            ),
            "rehearse": Command(f"{_STUDY}:rehearse", "Try a study with simulated raters."),
            "power": Command(f"{_STUDY}:power", "How many raters see which difference."),
        }
    )


bench = typer.Typer(name="bench", cls=BenchGroup)
learn = typer.Typer(name="learn", cls=LearnGroup)
study = typer.Typer(name="study", cls=StudyGroup)


@bench.callback()
def about_bench() -> None:
    """Measure what the documentation claims (docs/benchmarks.md)."""


@learn.callback()
def about_learn() -> None:
    """Learn models from recordings (docs/own-face.md, docs/recognition.md)."""


@study.callback()
def about_study() -> None:
    """Ask people which mouth looks right (docs/study.md)."""
