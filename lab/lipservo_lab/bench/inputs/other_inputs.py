"""Ranges of servos, boards, texts with mark-up, markers, photographs, and names of no files."""

import json
import os
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from calibration.capture.lerobot_ranges import read_ranges
from calibration.capture.marker_files import read_c3d
from firmware_bridge.bus_kinds import bus_kind
from firmware_bridge.clock import ManualClock
from firmware_bridge.errors import ServoError
from lipservo.display.photo_file import read_photo
from lipservo.runtime.servos.new_face import FoundJoint
from lipservo.settings.settings import parse_face
from lipservo_lab.bench.inputs.odd_input import REFUSED, Maker, OddInput
from lipsync.audio.file import checked_sound
from lipsync.errors import UserError
from lipsync.phoneme_files.label_file import LabelFile
from lipsync.phoneme_files.reader import read_labels
from lipsync.text_to_speech.spoken_form import spoken_form

#: Values of the position register, and the degrees that all of them are, by the makers' manuals.
_MANUALS: Final = {
    "dynamixel": {"XL330-M288": (4096, 360.0), "XL430-W250": (4096, 360.0)},
    "feetech": {"STS3215": (4096, 360.0), "SCS0009": (1024, 300.0)},
}
#: Channels of each board, by the maker's guide (pololu.com/docs/0J40); 16 of a PCA9685.
_BOARDS: Final = {"micro6": 6, "mini12": 12, "mini18": 18, "mini24": 24}


def _servo_range(rng: np.random.Generator, folder: Path) -> OddInput:
    """Write a recorded range of a servo, to be read as joint limits and zero offset, degrees.

    To be refused where its positions are beyond those of the servo's model.
    """
    kind = str(rng.choice(list(_MANUALS)))
    model = str(rng.choice(list(_MANUALS[kind])))
    # Positions of the model, and the degrees that all of them are.
    n, range_deg = _MANUALS[kind][model]
    neutral = int(rng.integers(n // 4, 3 * n // 4))
    least = int(rng.integers(max(1, neutral - n // 5), neutral))
    most = int(rng.integers(neutral + 1, neutral + n // 5))
    is_other = bool(rng.random() < 0.2)
    entry = {"id": 1, "drive_mode": 0, "homing_offset": 0, "range_min": least}
    entry |= {"range_max": n + most if is_other else most}
    path = folder / "ranges.json"
    path.write_text(json.dumps({"jaw": entry}))
    sign = int(rng.choice([1, -1]))
    step_deg = range_deg / n

    def read() -> tuple[object, Sequence[str]]:
        servo_model = bus_kind(kind).workshop().servo_models()[model]
        found = FoundJoint("jaw", 1, model, "opens", sign)
        joint = found.within(read_ranges(path)["jaw"], neutral, servo_model)
        return (joint.min_deg, joint.max_deg, joint.zero_offset_deg), ()

    ends = sorted(sign * (each - neutral) * step_deg for each in (least, most))
    right = (*ends, sign * (neutral - n // 2) * step_deg)
    return OddInput(f"{model} {entry}", read, REFUSED if is_other else right, tolerance=0.01)


def _board_channel(rng: np.random.Generator, _folder: Path) -> OddInput:
    """Write a face with a servo at a channel, to be refused where its board has no such channel."""
    board = str(rng.choice([*_BOARDS, "pca9685"]))
    channel = int(rng.integers(0, 30))
    is_maestro = board in _BOARDS
    bus = f"{{kind: maestro, model: {board}}}" if is_maestro else "{kind: pca9685}"
    face = (
        f"name: f\nrate_hz: 50\nbus: {bus}\nservos:\n  jaw: {{channel: {channel}, positive: opens, "
        "min_deg: -2, max_deg: 25, max_speed_deg_s: 300, us_per_deg: 11.1, neutral_us: 1500, "
        "min_us: 1450, max_us: 1800}\n"
    )

    def read() -> tuple[object, Sequence[str]]:
        settings = parse_face(face, "f.yaml")
        try:
            settings.bus_kind.open(settings.wiring, ManualClock())
        except ServoError as error:
            raise UserError(str(error)) from None
        return channel, ()

    right = channel if channel < _BOARDS.get(board, 16) else REFUSED
    return OddInput(f"channel {channel} of {board}", read, right)


_WORDS: Final = (
    *("bread", "butter", "river", "window", "candle", "garden", "yellow", "seven", "people"),
    *("music", "winter", "morning", "table", "paper"),
)
#: Mark-up around words W, and what is said of it.
_MARKS: Final = (
    *(("**W**", "W"), ("*W*", "W"), ("***W***", "W"), ("__W__", "W"), ("`W`", "W"), ("~~W~~", "")),
    *(("[W](https://a.example/b?c=d)", "W"), ("![W](a.png)", ""), ("<b>W</b>", "W"), ("W 😀", "W")),
    *(("W :-)", "W"), ("W ;)", "W"), ("W 👋🏽", "W"), ("W [1]", "W"), ("W[^2]", "W"), ("#W", "W")),
    *(('<prosody rate="slow">W</prosody>', "W"), ("<emphasis>W</emphasis>", "W"), ("@W", "W")),
    *(('W <break time="1s"/>', "W"), ("<mark name='m'/>W", "W"), ("W <!-- W -->", "W")),
    *(("W :wave:", "W"), ("W → W", "W W"), ("W 【3†source】", "W"), ("[laughs] W", "W")),
    *(("W &amp; W", "W and W"), ("(W)", "(W)"), ("W", "W"), ('"W"', '"W"'), ("W\\_W", "W W")),
)
#: Blocks of lines L, and what is said of them.
_BLOCKS: Final = (
    *(("# L", "L"), ("### L", "L"), ("- L\n- L", "L L"), ("1. L\n2. L", "L L"), ("> L", "L")),
    *(
        ("* [x] L\n* [ ] L", "L L"),
        ("L\n===", "L"),
        ("```\ncode(1)\n```\nL", "L"),
        ("---\n\nL", "L"),
    ),
    *(("| L | L |\n|---|---|\n| L | L |", "L, L L, L"), ("<think>no.</think>\nL", "L"), ("L", "L")),
    *(("• L\n• L", "L L"), ("L\n\n***\n\nL", "L L"), ("<speak>\nL\n</speak>", "L")),
)


def _fill(pair: tuple[str, str], fill: Callable[[], Any]) -> Any:
    """Fill the places W or L of a mark-up, and of what is to be spoken of it, alike.

    pair: (mark-up, spoken). fill: returns a written filling with what is spoken of it, a pair.
    Returns the filled pair.
    """
    written, spoken = pair
    fillings = []
    for _ in range(max(written.count("W") if "W" in written else 0, written.count("L"))):
        fillings.append(fill())
    written_parts, spoken_parts, n_filled = [], [], 0
    for part in re.split(r"([WL])", written):
        written_parts.append(fillings[n_filled][0] if part in ("W", "L") else part)
        n_filled += part in ("W", "L")
    n_filled = 0
    for part in re.split(r"([WL])", spoken):
        spoken_parts.append(fillings[n_filled][1] if part in ("W", "L") else part)
        n_filled += part in ("W", "L")
    return "".join(written_parts), "".join(spoken_parts)


def _marked_up_text(rng: np.random.Generator, _folder: Path) -> OddInput:
    """Write a text with mark-up, of which the right words are to be spoken, in their order."""

    def word() -> tuple[str, str]:
        chosen = str(rng.choice(_WORDS))
        return chosen, chosen

    def line() -> tuple[str, str]:
        marks = [_MARKS[int(rng.integers(len(_MARKS)))] for _ in range(int(rng.integers(1, 5)))]
        parts = [("plain", "plain"), *(_fill(pair, word) for pair in marks)]
        return " ".join(p[0] for p in parts), " ".join(p[1] for p in parts if p[1])

    blocks = [_BLOCKS[int(rng.integers(len(_BLOCKS)))] for _ in range(int(rng.integers(1, 4)))]
    filled_blocks = [_fill(pair, line) for pair in blocks]
    written = "\n\n".join(each[0] for each in filled_blocks)
    words = re.findall(r"\w+", " ".join(each[1] for each in filled_blocks))
    return OddInput(written, lambda: (re.findall(r"\w+", spoken_form(written)), ()), words)


def _c3d_file(rng: np.random.Generator, folder: Path) -> OddInput:
    """Write a C3D file of markers in some unit; it is to be read as places in mm.

    Some markers are lost in some frames (zeros or negative residuals), and one may be an angle. To
    be refused where two have the same name, or the unit is missing.
    """
    import ezc3d

    n = int(rng.choice([4, 4, 4, 300]))
    labels = [f"m{i}" for i in range(n)]
    places = np.round(rng.uniform(-50, 50, (n, 3)), 2)
    data = np.ones((4, n, 9))
    data[:3] = places.T[:, :, None]
    residuals = np.zeros((1, n, 9))
    loss = rng.integers(0, 3, n)
    for i in np.flatnonzero(loss):
        data[:3, i, :6] = 0.0 if loss[i] == 1 else 99.0
        residuals[0, i, :6] = 0.0 if loss[i] == 1 else -1.0
    file = ezc3d.c3d()
    point = file["parameters"]["POINT"]
    unit = str(rng.choice(["mm", "mm", "cm", "m", ""]))
    point["UNITS"]["value"], point["RATE"]["value"] = [unit], [100.0]
    is_duplicate = bool(rng.random() < 0.15)
    written_labels = [labels[1], *labels[1:]] if is_duplicate else labels
    point["LABELS"]["value"] = written_labels[:255]
    file["data"]["points"], file["data"]["meta_points"]["residuals"] = data, residuals
    if n > 255:
        file.add_parameter("POINT", "LABELS2", written_labels[255:])
    is_angle = bool(rng.random() < 0.3) and not is_duplicate
    if is_angle:
        file.add_parameter("POINT", "ANGLES", [labels[0]])
    path = folder / "pose_1.c3d"
    file.write(str(path))
    scale = {"mm": 1.0, "cm": 10.0, "m": 1000.0}.get(unit)

    def read() -> tuple[object, Sequence[str]]:
        return {name: place.tolist() for name, place in read_c3d(path).items()}, ()

    right: object = REFUSED
    if scale is not None and not is_duplicate:
        right = {x: (scale * places[i]).tolist() for i, x in enumerate(labels) if i >= is_angle}
    return OddInput(f"{n} points, {unit!r}, {loss[:4]}", read, right, tolerance=0.5)


def _oriented_photo(rng: np.random.Generator, folder: Path) -> OddInput:
    """Write a photograph whose left half is dark, with any EXIF orientation, valid or not."""
    from PIL import Image

    pixels = np.full((80, 120, 3), 220, dtype=np.uint8)
    pixels[:, :60] = 30
    orientation = int(rng.choice([1, 3, 6, 8, 0, 9, 99, 65_535]))
    exif = Image.Exif()
    exif[0x0112] = orientation
    path = folder / "a.png"
    Image.fromarray(pixels).save(path, exif=exif)
    # EXIF 2.32, 4.6.4: where the first row and column of the picture belong.
    upright = {3: pixels[::-1, ::-1], 6: np.rot90(pixels, -1), 8: np.rot90(pixels)}.get(
        orientation, pixels
    )

    def read() -> tuple[object, Sequence[str]]:
        return bool(np.array_equal(read_photo(path)[0], upright)), ()

    return OddInput(f"orientation {orientation}", read, right=True)


def _unreadable_path(rng: np.random.Generator, folder: Path) -> OddInput:
    """Choose a path that is no readable file, and a reader, which is to refuse it.

    Pipes, devices, folders, a link to itself, impossible names.
    """
    link = folder / "link"
    link.symlink_to(link)
    os.mkfifo(folder / "pipe")
    paths: list[Path] = [folder / "pipe", folder, link, folder / "none", Path("x" * 100_000)]
    paths += [Path("/dev/zero"), Path("/dev/null"), Path("a\0b"), Path("/proc/self/mem")]
    path = paths[int(rng.integers(len(paths)))]
    reader_number = int(rng.integers(4))

    def read() -> tuple[object, Sequence[str]]:
        """Read the path with the drawn reader: labels, sound, C3D or photograph."""
        readers: list[Callable[[], object]] = [
            lambda: read_labels(LabelFile(path)),
            lambda: checked_sound(path),
            lambda: read_c3d(path),
            lambda: read_photo(path),
        ]
        return readers[reader_number](), ()

    return OddInput(f"{str(path)[:40]!r} by reader {reader_number}", read, REFUSED)


OTHER_KINDS: Final[dict[str, Maker]] = {
    "servos: ranges": _servo_range,
    "servos: channels of boards": _board_channel,
    "texts: mark-up": _marked_up_text,
    "markers: C3D": _c3d_file,
    "photographs: orientation": _oriented_photo,
    "names of no files": _unreadable_path,
}
