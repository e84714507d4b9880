"""Weights made as sure as they are right, by their temperature.

    python benchmarks/temper_ears.py CORPORA ALIGNMENTS WEIGHTS.npz [TEMPERATURE OUT.npz]

Prints the calibration errors of phones and visemes at several temperatures, head by head, in
utterances of the validation talkers of each corpus, and then writes the weights at TEMPERATURE.
CORPORA and ALIGNMENTS are those of train_ears.py.
"""

import sys
from pathlib import Path

import numpy as np
from lipservo_lab.corpus.alignment_cache import read_alignments
from lipservo_lab.corpus.transcribed import read_speakers, read_transcribed
from lipservo_lab.learning.recognition.temperature import reliability, tempered
from lipservo_lab.learning.recognition.training_data import as_array, read_labelled

from lipsync.recognition.network import StreamingNetwork, load_weights, save_weights

TEMPERATURES = (1.0, 1.05, 1.1, 1.15, 1.2, 1.3)
#: Utterances of each corpus, evenly spaced.
MOST = 40


def main() -> None:
    """Print the table and write the weights."""
    corpora, alignments = Path(sys.argv[1]), read_alignments(Path(sys.argv[2]))
    weights = load_weights(Path(sys.argv[3]))
    talkers = read_speakers(Path(__file__).parent / "speakers" / "validation.csv")
    for corpus in ("librispeech", "speechocean762", "picovoice_commands"):
        spoken = [
            u for u in read_transcribed(corpora / corpus)
            if u.speaker in talkers and u.name in alignments and not alignments[u.name].error
        ]  # fmt: skip
        places = np.linspace(0, len(spoken) - 1, min(MOST, len(spoken))).round().astype(int)
        heard = [read_labelled(spoken[n], alignments[spoken[n].name]) for n in places]
        array = as_array(heard, weights.scale, weights.delays)
        print(f"{corpus}, {len(heard)} utterances, phones / visemes")
        for temperature in TEMPERATURES:
            network = StreamingNetwork(tempered(weights, temperature))
            posteriors = network.push(array.features.astype(np.float32))
            errors = []
            for head, targets in enumerate(array.targets.T):
                known = targets >= 0
                errors.append(reliability(posteriors[known, head], targets[known]))
            print(f"  {temperature:.2f}", *("{:.3f} / {:.3f}".format(*each) for each in errors))
    if len(sys.argv) > 4:
        save_weights(tempered(weights, float(sys.argv[4])), sys.argv[5])


if __name__ == "__main__":
    main()
