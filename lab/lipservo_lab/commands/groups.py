"""`lipservo bench`, `learn` and `study`: where each command of the lab is."""

from types import MappingProxyType

import typer

from lipservo.commands.lazy_group import Command, LazyGroup

_BENCH, _LEARN = "lipservo_lab.commands.bench", "lipservo_lab.commands.learn"
_STUDY = "lipservo_lab.commands.study.study"
_MOTION, _HEARING = "Motion", "Hearing"
_SERVOS, _OTHER = "Servos and stops", "Calibration, faces and pictures"


class BenchGroup(LazyGroup):
    """Each prints figures that the documentation gives."""

    prefix = "bench."

    table = MappingProxyType(
        {
            "motion": Command(f"{_BENCH}.motion:motion", "Motion against recordings.", _MOTION),
            "readability": Command(
                f"{_BENCH}.readability:readability", "Words read off the mouth.", _MOTION
            ),
            "figures": Command(f"{_BENCH}.motion:figures", "The paper's tables.", _MOTION),
            "closures": Command(f"{_BENCH}.closures:closures", "How often lips close.", _MOTION),
            "sync": Command(f"{_BENCH}.faces:sync", "Lips against their sound.", _MOTION),
            "synthesis": Command(f"{_BENCH}.bench:synthesis", "Speed of the motion.", _MOTION),
            "line": Command(f"{_BENCH}.faces:line", "Serial lines that lose bytes.", _MOTION),
            "shapes": Command(f"{_BENCH}.faces:shapes", "Mouth shapes for avatars.", _MOTION),
            "recognition": Command(
                f"{_BENCH}.recognition:recognition", "Phonemes and visemes recognised.", _HEARING
            ),
            "listening": Command(
                f"{_BENCH}.recognition:listening", "False speech, delays of the mouth.", _HEARING
            ),
            "microphone": Command(
                f"{_BENCH}.closures:microphone", "Delay and closures at a microphone.", _HEARING
            ),
            "nonspeech": Command(
                f"{_BENCH}.closures:nonspeech", "Sounds that are no speech.", _HEARING
            ),
            "languages": Command(f"{_BENCH}.recognition:languages", "Other languages.", _HEARING),
            "voices": Command(
                f"{_BENCH}.recognition:voices", "Texts in synthetic voices.", _HEARING
            ),
            "texts": Command(f"{_BENCH}.recognition:texts", "Alignment of false texts.", _HEARING),
            "ladder": Command(
                f"{_BENCH}.closures:ladder", "The recogniser on a busy computer.", _HEARING
            ),
            "bus": Command(f"{_BENCH}.bench:bus", "The servo bus beside its rivals.", _SERVOS),
            "faults": Command(f"{_BENCH}.bench:faults", "Faults, stops and signals.", _SERVOS),
            "endurance": Command(f"{_BENCH}.bench:endurance", "Many cycles of one face.", _SERVOS),
            "cost": Command(f"{_BENCH}.cost:cost", "Cost of a face at rest.", _SERVOS),
            "fleet": Command(f"{_BENCH}.fleet:fleet", "A hundred faces at once.", _SERVOS),
            "replay": Command(f"{_BENCH}.bench:replay", "Speed of a replay.", _SERVOS),
            "house": Command(f"{_BENCH}.bench:house", "Count the source's lines.", _OTHER),
            "inputs": Command(f"{_BENCH}.inputs:inputs", "Odd files and texts.", _OTHER),
            "calibration": Command(
                f"{_BENCH}.bench:calibration", "Calibration of simulated robots.", _OTHER
            ),
            "display": Command(
                f"{_BENCH}.display:display", "Photographs and films that speak.", _OTHER
            ),
            "face": Command(f"{_BENCH}.faces:face", "Expression and dashboard.", _OTHER),
            "agent": Command(f"{_BENCH}.agents:agent", "What an agent remembers.", _OTHER),
            "day": Command(f"{_BENCH}.agents:day", "An agent and a face all day.", _OTHER),
            "cluster": Command(
                f"{_BENCH}.fleet:cluster", "Rendering while workers are killed.", _OTHER
            ),
            "scans": Command(f"{_BENCH}.faces:scans", "Registration of scans.", _OTHER),
            "study": Command(f"{_BENCH}.study:study", "Simulated raters of a study.", _OTHER),
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
