"""Makes data/recognizer_posteriors.npz with torch, once for each new set of shipped weights.

Run `PYTHONPATH=tests/support python tests/data/make_recognizer_posteriors.py`; it is no test.
"""

import numpy as np
import soundfile
import torch
from places import DATA
from speech import CLIP_PATH

from lipsync.recognition.features import LevelNormalizer, LogMelStream
from lipsync.recognition.network import load_shipped_weights

FIRST, END = 100, 120


def convolved(layer, hidden):
    n_out, n_in = layer.kernel.shape[1], layer.kernel.shape[0] // 3
    kernel = torch.from_numpy(layer.kernel).reshape(3, n_in, n_out).permute(2, 1, 0)
    padded = torch.nn.functional.pad(hidden, (2 * layer.dilation, 0))
    bias = torch.from_numpy(layer.bias)
    return torch.relu(torch.conv1d(padded, kernel, bias, dilation=layer.dilation))


def main() -> None:
    weights = load_shipped_weights()
    clip = soundfile.read(CLIP_PATH, dtype="float32")[0][:32_000]
    features = LevelNormalizer(weights.scale).push(LogMelStream().push(clip))[:END]
    hidden = convolved(weights.entry, torch.from_numpy(features.T[None]))
    for layer in weights.residuals:
        hidden = hidden + convolved(layer, hidden)
    logits = hidden[0].T @ torch.from_numpy(weights.output) + torch.from_numpy(weights.output_bias)
    posteriors = torch.softmax(logits.reshape(END, len(weights.delays), -1), dim=2)[FIRST:]
    path = DATA / "recognizer_posteriors.npz"
    np.savez_compressed(path, posteriors=posteriors.numpy().astype(np.float16))


if __name__ == "__main__":
    main()
