"""Make the folder of a study: its clips, what raters get, the key, and what two machines read.

The machine readers do the part without sound as people do: they were fitted on the recorded words
of sentences that the study does not show, and read every clip once.
"""

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from lipservo_lab.corpus.utterance import Corpus, Utterance
from lipservo_lab.evaluation.readability.readers import (
    READERS,
    fit_reader,
    slotted,
    spoken_words,
    words_of_slot,
)
from lipservo_lab.learning.motion.trained_model import TrainedModel
from lipservo_lab.output_folder import folder_written_whole
from lipservo_lab.study.answers import Record, line_of
from lipservo_lab.study.sheets import (
    CLIPS,
    MACHINES_FILE,
    Key,
    Sentence,
    Size,
    Study,
    StudyError,
    make_study,
    sentences_needed,
    write_study,
)
from lipservo_lab.study.shown_methods import FacesOf, vocabulary_of
from lipsync.arrays import Array
from lipsync.output_file import write_whole

#: Writes a film of faces (n, n_components), so many a second, with the sound of a file, to a path.
Film = Callable[[Array, float, Path, Path], None]
Advance = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class Plan:
    """Settings of a study.

    seed: determines sheets and names of clips.
    """

    methods: tuple[str, ...]
    size: Size
    seed: str
    title: str
    consent: str


@dataclass(slots=True)
class Material:
    """The sentences of a study, and their faces, made once for film and readers.

    read: held-out sentences to choose from; learned: sentences that the readers are fitted on.
    faces_of: returns the faces of a method for a sentence.
    """

    model: TrainedModel
    read: Sequence[Utterance]
    learned: Sequence[Utterance]
    faces_of: FacesOf
    _made: dict[tuple[str, str], Array] = field(default_factory=dict)

    def faces(self, method: str, utterance: Utterance) -> Array:
        """Return a method's motion of a sentence; it is made at the first call.

        Parameters
        ----------
        method : str
            Name of the method.
        utterance : Utterance
            The sentence.

        Returns
        -------
        Array
            (n_frames, n_components).
        """
        key = method, utterance.name
        if key not in self._made:
            self._made[key] = self.faces_of(method, utterance)
        return self._made[key]


def held_out(corpus: Corpus, test: frozenset[str], seed: str) -> tuple[Utterance, ...]:
    """Return the test sentences whose words are known, in an order that the seed determines."""
    sentences = [u for u in slotted(corpus.utterances) if u.name in test]
    order = np.random.default_rng(list(seed.encode())).permutation(len(sentences))
    return tuple(sentences[i] for i in order)


def planned_study(
    plan: Plan, read: Sequence[Utterance], learned: Sequence[Utterance]
) -> tuple[Study, Key]:
    """Plan a study without its clips. Raises StudyError.

    read, learned: sentences, as in `Material`; the vocabulary is that of `learned`.
    """
    sentences = [
        Sentence(
            u.name,
            tuple(word.text.lower() for word in spoken_words(u)),
            round(len(u.markers_mm) / u.frame_rate_hz, 3),
        )
        for u in read[: sentences_needed(plan.size, len(plan.methods))]
    ]
    sentence_words = [tuple(w.text.lower() for w in spoken_words(u)) for u in learned]
    return make_study(
        plan.methods,
        sentences,
        plan.size,
        plan.seed,
        title=plan.title,
        consent=plan.consent,
        vocabulary=vocabulary_of(sentence_words),
    )


def write_made_study(
    folder: Path, study: Study, key: Key, material: Material, film: Film, advance: Advance
) -> None:
    """Write the folder of a study completely or not at all.

    advance: called with clips done and all clips. Raises OutputError, StudyError for a nearly full
    disk, and what `film` raises.
    """
    by_name = {u.name: u for u in material.read}
    with folder_written_whole(folder) as partial:
        (partial / CLIPS).mkdir(parents=True)
        for number, (name, clip) in enumerate(key.clips.items()):
            utterance = by_name[clip.sentence]
            faces = material.faces(clip.method, utterance)
            path = partial / CLIPS / f"{name}.mp4"
            film(faces, utterance.frame_rate_hz, utterance.sound_path, path)
            advance(number + 1, len(key.clips))
        records = machine_records(study, key, material)
        write_whole(partial / MACHINES_FILE, b"".join(map(line_of, records)))
        write_study(partial, study, key)
        free = shutil.disk_usage(partial).free
        if free < _LEAST_FREE_BYTES:
            raise StudyError(f"{folder}: the disk is nearly full; answers need 100 MB of room")


_LEAST_FREE_BYTES = 100_000_000


def machine_records(study: Study, key: Key, material: Material) -> list[Record]:
    """Let each machine reader read each clip that is shown without sound; return the records.

    Empty if the study shows no clip without sound.
    """
    by_name = {u.name: u for u in material.read}
    clip_names = sorted(
        {
            clip
            for sheet in study.sheets
            for item in sheet
            if item.kind == "reading"
            for clip in item.clips
        }
    )
    if not clip_names:
        return []
    records: list[Record] = []
    model, learned = material.model, list(material.learned)
    slots = range(len(spoken_words(learned[0])))
    for kind in READERS:
        recorded = {u.name: kind.view(model, u.markers_mm) for u in learned}
        reader = fit_reader(kind, learned, recorded, slots)
        for name in clip_names:
            clip = key.clips[name]
            utterance = by_name[clip.sentence]
            faces = material.faces(clip.method, utterance)
            seen: Mapping[str, Array] = {utterance.name: kind.view(model, model.markers_mm(faces))}
            words = [
                str(reader.classifiers[slot].predict(words_of_slot([utterance], seen, slot))[0])
                for slot in slots
            ]
            records.append({"reader": kind.name, "clip": name, "answer": " ".join(words).lower()})
    return records
