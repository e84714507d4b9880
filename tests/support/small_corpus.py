"""Writes a made-up corpus folder in the layout of grid_s1: a face that opens and turns."""

import json
from itertools import accumulate, pairwise
from pathlib import Path

import numpy as np
import soundfile
from label_files import textgrid

from lipsync.markers import MARKERS_47

FRAME_RATE_HZ = 25.0
RIGID = (33, 263, 10, 152000, 6, 168)
PHONES = (("SIL", 0.4), ("B", 0.1), ("AA", 0.2), ("T", 0.1), ("UW", 0.2), ("SIL", 0.2))


def write_corpus(folder: Path, n_sentences: int = 6, seed: int = 0) -> Path:
    """Sentences s0, s1, ... of PHONES in changing order; 30 frames each. Returns the folder."""
    rng = np.random.default_rng(seed)
    ids = [*RIGID, *MARKERS_47.landmarks]
    for name in ("audio", "landmarks", "labels"):
        (folder / name).mkdir(parents=True)
    layout = {"frame_rate_hz": FRAME_RATE_HZ, "landmark_ids": ids, "groups": {"rigid": RIGID}}
    (folder / "landmarks.json").write_text(json.dumps(layout))
    face = rng.normal(0.0, 30.0, (len(ids), 3))
    face[:2] = [[-33.0, 40.0, 0.0], [33.0, 40.0, 0.0]]
    for number in range(n_sentences):
        middle = [PHONES[1 + (i + number) % 4] for i in range(4)]
        write_sentence(folder, f"s{number}", face, [PHONES[0], *middle, PHONES[-1]], rng)
    return folder


def write_sentence(
    folder: Path,
    name: str,
    face: np.ndarray,
    phones: list[tuple[str, float]],
    rng: np.random.Generator,
) -> None:
    duration_s = sum(duration for _, duration in phones)
    n_frames = round(duration_s * FRAME_RATE_HZ)
    opens = ("jaw", "chin", "outer_lip_17", "inner_lip_14")
    lower = [i for i, n in enumerate(MARKERS_47.names) if n.startswith(opens)]
    points = np.repeat(face[None], n_frames, axis=0)
    opening = np.abs(np.sin(np.linspace(0, 7, n_frames))) * 10.0
    points[:, [len(RIGID) + i for i in lower], 1] += opening[:, None]
    points[:, len(RIGID) :] += rng.normal(0.0, 0.2, (n_frames, len(MARKERS_47.names), 3))
    turned = turn(points, np.linspace(0.0, 0.3, n_frames), 1.0 + 0.1 * rng.random())
    pixels = np.round((turned + 150.0) * 64).astype(np.int16)
    np.savez(folder / "landmarks" / f"{name}.npz", landmarks_64th_px=pixels)
    samples = rng.normal(0.0, 0.1, round(duration_s * 16_000)).astype(np.float32)
    soundfile.write(folder / "audio" / f"{name}.flac", samples, 16_000)
    (folder / "labels" / f"{name}.TextGrid").write_text(text_grid(phones))


def turn(points: np.ndarray, angle_rad: np.ndarray, scale: float) -> np.ndarray:
    """Nodding and shifting: what the reader has to take away again."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    o, e = np.zeros_like(c), np.ones_like(c)
    rotation = np.array([[e, o, o], [o, c, -s], [o, s, c]]).transpose(2, 0, 1)
    return scale * np.einsum("fij,fpj->fpi", rotation, points) + angle_rad[:, None, None] * 20.0


def text_grid(phones: list[tuple[str, float]]) -> str:
    """A Praat TextGrid with a `words` and a `phones` tier."""
    edges_s = list(accumulate((duration for _, duration in phones), initial=0.0))
    rows = [(label, *times) for (label, _), times in zip(phones, pairwise(edges_s), strict=True)]
    return textgrid(
        {"words": [("word", edges_s[-1] / 2, edges_s[-1])], "phones": rows}, edges_s[-1]
    )
