"""Made-up tracks: a head whose nods follow the loudness of a made-up voice; and a small model."""

import csv
from pathlib import Path

import numpy as np
import soundfile
from lipservo_lab.learning.learned_expression.expression_model import ExpressionModel
from lipservo_lab.learning.learned_expression.pose_mixture import PoseMixture
from synthetic_voice import room, voice

RATE_HZ = 25.0
COLUMNS = (
    "time_s", "neck_pitch_deg", "neck_yaw_deg", "neck_roll_deg",
    "eye_yaw_deg", "eye_pitch_deg", "lid_left", "lid_right",
)  # fmt: skip


def sway(n_frames: int, rng: np.random.Generator, decay: float = 0.9) -> np.ndarray:
    """A smooth random walk that comes back (n_frames,), of unit variance: of second order."""
    values = np.zeros(n_frames + 100)
    for i in range(2, len(values)):
        values[i] = 2.0 * decay * values[i - 1] - decay**2 * values[i - 2] + rng.normal()
    return values[100:] / values[100:].std()


def write_tracks(folder: Path, n_tracks: int = 8, duration_s: float = 12.0, seed: int = 0) -> Path:
    """NAME.csv and NAME.wav, n_tracks of each: the louder the voice the lower the head."""
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    n_frames = round(duration_s * RATE_HZ)
    for number in range(n_tracks):
        samples = voice(duration_s, rng) + room(duration_s, rng)
        loud = np.sqrt(np.mean(np.square(samples.reshape(n_frames, -1)), axis=1))
        smooth = np.convolve(loud, np.hanning(7) / np.hanning(7).sum(), mode="full")[:n_frames]
        poses = np.stack([sway(n_frames, rng) for _ in range(3)], axis=1)
        poses[:, 0] -= 60.0 * smooth
        gaze = -0.5 * poses[:, [1, 0]] + 0.2 * rng.standard_normal((n_frames, 2))
        lid = np.clip(-0.02 * gaze[:, 1], 0.0, 1.0)
        for start in np.cumsum(rng.lognormal(0.7, 0.5, 20)):
            first = round(start * RATE_HZ)
            lid[first : first + 4] = 1.0
        rows = np.column_stack((np.arange(n_frames) / RATE_HZ, poses, gaze, lid, lid))
        write_csv(folder / f"t{number:02d}.csv", rows)
        soundfile.write(folder / f"t{number:02d}.wav", samples, 16_000)
    return folder


def write_csv(path: Path, rows: np.ndarray, columns: tuple[str, ...] = COLUMNS) -> Path:
    """A header and the rows, rounded to 0.0001."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows([[f"{value:.4f}" for value in row] for row in rows])
    return path


def small_model(n_parts: int = 3, seed: int = 0) -> ExpressionModel:
    """A stable head that nods with loudness, gaze against the head, blinks every 2 s or so."""
    rng = np.random.default_rng(seed)
    poses = np.stack([sway(20_000, rng) for _ in range(3)], axis=1)
    prosody = rng.standard_normal((20_000, 2))
    poses[:, 0] -= 0.5 * np.convolve(prosody[:, 1], np.ones(5), mode="full")[:20_000]
    speed = np.diff(poses, axis=0) * RATE_HZ
    bend = np.diff(speed, axis=0) * RATE_HZ
    x = np.concatenate((poses[2:], speed[1:], bend, prosody[2:]), axis=1)
    means, precisions = [], []
    for part in np.array_split(x[np.argsort(x[:, 10])], n_parts):
        means.append(part.mean(axis=0))
        precisions.append(np.linalg.inv(np.cov(part.T) + np.diag(1e-4 * part.var(axis=0))))
    head = PoseMixture(
        np.full(n_parts, 1.0 / n_parts), np.array(means), np.array(precisions), 1.0 / RATE_HZ
    )
    gaze = np.zeros((2, 21))
    gaze[0, 1] = gaze[1, 0] = -0.5
    lids = np.array([0.02, 0.0, 0.0, 0.0, 0.0, 0.0])
    farthest = np.array([8.0, 8.0, 8.0])
    return ExpressionModel(head, farthest, gaze, np.array([10.0, 10.0]), lids, (0.5, 0.6))
