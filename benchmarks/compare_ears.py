"""Weights of the recogniser compared on every scored talker, condition by condition, as a table.

    python benchmarks/compare_ears.py CORPORA ALIGNMENTS MOST NEW.npz OLD.npz [OLD.npz ...]

CORPORA holds librispeech, speechocean762 and picovoice_commands; ALIGNMENTS is the file of the
scored talkers' alignments (`lipservo lines align`), which must be those of scored_alignments.txt.
MOST: so many utterances at most in each condition but the first, evenly spaced. Frames as they are
settled live at 95 ms; intervals: 95 % of 2,000 paired bootstrap samples of utterances. Of clean
speech also the calibration errors of phones and visemes, by the head of 95 ms, without a decoder.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from lipservo_lab.corpus.alignment_cache import AlignedUtterance, read_alignments
from lipservo_lab.corpus.scored_alignments import alignment_hash, read_hashes
from lipservo_lab.corpus.transcribed import TranscribedUtterance, read_transcribed
from lipservo_lab.evaluation.recognition.conditions import parse_condition
from lipservo_lab.evaluation.recognition.recognition_scores import Score, settled_score
from lipservo_lab.learning.recognition.augmentation import LabelledSamples
from lipservo_lab.learning.recognition.temperature import reliability

from lipsync.audio.file import read_speech
from lipsync.phonemes import SILENCE, VISEME_OF
from lipsync.recognition.batch import recording_posteriors
from lipsync.recognition.network import load_weights

HASHES = Path(__file__).parent / "speakers" / "scored_alignments.txt"
NOISES = (
    "white:10",
    "babble:10",
    "music:10",
    "telephone",
    "level:-30",
    "servos:10",
    "clipped",
    "room:1",
    "room:2.5",
)
CONDITIONS = (
    ("librispeech", None),
    ("picovoice_commands", None),
    ("speechocean762", None),
    *(("librispeech", noise) for noise in NOISES),
)
#: Frames that the head of 95 ms waits.
DELAY = 7
BABBLERS = slice(None, None, 40)
N_SAMPLES = 2_000


def spread(utterances: Sequence[TranscribedUtterance], most: int) -> list[TranscribedUtterance]:
    """So many of them, evenly spaced."""
    places = np.linspace(0, len(utterances) - 1, min(most, len(utterances)))
    return [utterances[place] for place in places.round().astype(int)]


def right(scores: Sequence[Score]) -> np.ndarray:
    """(n, 2): of each utterance the frames of speech with the right viseme, and those of speech."""
    spoken = np.arange(len(scores[0].confusion)) != VISEME_OF[SILENCE]
    tables = np.array([each.confusion for each in scores])
    hits = np.einsum("nii->ni", tables)[:, spoken].sum(axis=1)
    return np.stack((hits, tables[:, spoken].sum(axis=(1, 2))), axis=1)


def main() -> None:
    """Print the table."""
    corpora, cache, most = Path(sys.argv[1]), read_alignments(Path(sys.argv[2])), int(sys.argv[3])
    names = sys.argv[4:]
    hashes = read_hashes(HASHES)
    scored = {name: each for name, each in cache.items() if each.beams == "default"}
    if moved := [n for n, each in scored.items() if hashes.get(n) != alignment_hash(each)]:
        sys.exit(f"{moved[0]} and {len(moved) - 1} others: not the alignments of {HASHES.name}")
    for corpus, noise in CONDITIONS:
        spoken = [u for u in read_transcribed(corpora / corpus) if u.name in scored]
        whole = corpus == "librispeech" and noise is None
        chosen = spoken if whole else spread(spoken, most)
        heard = [disturbed(u, scored[u.name], noise, spoken) for u in chosen]
        told = {
            name: [settled_score(load_weights(Path(name)), [each]) for each in heard]
            for name in names
        }
        print(f"{corpus} {noise or 'clean'}, {len(chosen)} utterances")
        for name in names:
            sure = "" if noise else "; sure {:.3f} / {:.3f}".format(*sureness(name, heard))
            print("  " + row(told[name], told[names[0]]) + f"{sure}  {name}", flush=True)


def disturbed(
    utterance: TranscribedUtterance,
    aligned: AlignedUtterance,
    noise: str | None,
    others: Sequence[TranscribedUtterance],
) -> LabelledSamples:
    """The utterance as it is heard, and what is said in it."""
    samples = read_speech(utterance.sound)
    if noise is not None:
        voices = [read_speech(u.sound) for u in others[BABBLERS]] if "babble" in noise else []
        samples = parse_condition(noise).apply(samples, utterance.name, voices)
    return LabelledSamples(samples, aligned.labels(len(samples) // 160))


def sureness(name: str, heard: Sequence[LabelledSamples]) -> tuple[float, float]:
    """The calibration errors of phones and visemes of all utterances together."""
    weights = load_weights(Path(name))
    head = weights.delays.index(DELAY)
    posteriors = [
        recording_posteriors(weights, each.samples, len(each.labels) + DELAY)[DELAY:, head]
        for each in heard
    ]
    return reliability(np.concatenate(posteriors), np.concatenate([each.labels for each in heard]))


def row(scores: Sequence[Score], new: Sequence[Score]) -> str:
    """Figures of all utterances together, and how much more the new ones have right."""
    rng, ours, theirs = np.random.default_rng(0), right(new), right(scores)
    chosen = rng.integers(0, len(scores), (N_SAMPLES, len(scores)))
    one, other = ours[chosen].sum(axis=1), theirs[chosen].sum(axis=1)
    low, high = np.percentile(one[:, 0] / one[:, 1] - other[:, 0] / other[:, 1], (2.5, 97.5))
    hits, frames = theirs.sum(axis=0)
    counts = [each.bilabials for each in scores]
    found, said = sum(c.n_found for c in counts), sum(c.n_reported for c in counts)
    recall = found / sum(c.n_spoken for c in counts)
    precision = sum(c.n_true for c in counts) / max(1, said)
    per = sum(s.n_edits for s in scores) / sum(s.n_phones for s in scores)
    return (
        f"speech {hits / frames:.3f}, new more by {low:+.3f} to {high:+.3f}; PER {per:.3f}; "
        f"P B M {recall:.3f} at {precision:.3f}"
    )


if __name__ == "__main__":
    main()
