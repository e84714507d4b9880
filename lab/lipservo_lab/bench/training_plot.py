"""The picture of a recogniser's training: its loss, and what the validation speakers say."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from lipservo.terminal.pictures import save_picture, without_screen
from lipsync.errors import UserError

Record = Mapping[str, float]


class TrainingLogError(UserError):
    """A run log that cannot be drawn; the message is one line."""


def read_log(path: Path) -> list[Record]:
    """The lines of a `log.jsonl`; TrainingLogError for a file that is none."""
    try:
        records = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    except OSError as error:
        raise TrainingLogError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise TrainingLogError(f"{path}: no run log: not one JSON object a line") from error
    if not records or not all(
        isinstance(r, dict) and {"step", "loss"} <= r.keys() for r in records
    ):
        raise TrainingLogError(f"{path}: no run log: every line must hold a step and a loss")
    return records


def draw_log(records: Sequence[Record], picture: Path) -> None:
    """Loss on the left, accuracies of visemes by condition on the right, over the steps."""
    without_screen()
    from matplotlib import pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    left.plot([r["step"] for r in records], [r["loss"] for r in records])
    left.set(xlabel="step", ylabel="loss", title="training")
    checked = [r for r in records if len(r) > 2]
    for key in sorted(checked[-1]) if checked else ():
        if key.endswith("_viseme_all"):
            points = [(r["step"], r[key]) for r in checked if key in r]
            name = key.removesuffix("_viseme_all").replace("_", " ")
            right.plot(*zip(*points, strict=True), marker="o", label=name)
    right.set(xlabel="step", ylabel="visemes right, all frames", title="validation speakers")
    if right.lines:
        right.legend(fontsize="small")
    save_picture(figure, picture)
    plt.close(figure)
