"""Command lines that cannot work, run in one process, and what becomes of each."""

import contextlib
import io
import os
import shlex
import sys
import traceback
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np
from places import DATA

from lipservo import command_line

TABLE = DATA / "bad_inputs.txt"


def command_lines() -> list[str]:
    lines = TABLE.read_text(encoding="utf-8").splitlines()
    return [line for line in lines if line and not line.startswith("#")]


@dataclass(frozen=True)
class Outcome:
    """status: None when something was raised that the command line does not understand."""

    status: object
    stderr: str
    changed: list[str]

    @property
    def is_traceback(self) -> bool:
        return self.status is None or "Traceback" in self.stderr

    @property
    def complaints(self) -> list[str]:
        return [line for line in self.stderr.splitlines() if line.startswith("lipservo: ")]


def make_files(folder: Path) -> None:
    """Everything that the table names, and nothing it says is not there."""
    faces = resources.files("lipservo.config")
    model = (resources.files("lipsync.models") / "grid_s1.npz").read_bytes()
    middle = len(model) // 2
    binary = bytes(range(256)) * 40
    bomb = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "".join(
        f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 9)
    )
    face = (faces / "face_sim.yaml").read_text()
    calibration = (faces / "face_sim.calibration.yaml").read_text()
    joints = [line.strip()[:-1] for line in calibration.splitlines() if _is_joint(line)]
    plan = ["pose", *(f"{joint}_deg" for joint in joints)]
    contents: dict[str, bytes | str] = {
        "empty": b"",
        "binary": binary,
        "text.txt": "hello\n",
        "cut.npz": model[:middle],
        "spoilt.npz": model[:middle] + b"\xff" * 200 + model[middle + 200 :],
        "face.yaml": face,
        "octal.yaml": face.replace("id: 11", "id: 0o999"),
        "cal.yaml": calibration,
        "\udcffcal.yaml": calibration,
        "deep.yaml": "[" * 5_000,
        "deepcal.yaml": "[" * 100_000,
        "deep.json": "[" * 100_000,
        "other.json": '{"a": 1}',
        "bomb.yaml": f"{bomb}name: *a8\nversion: *a8\n",
        "key.yaml": "1: 2\n",
        "half.yaml": 'kiosks:\n  hall: {url: "https://hall.example", token_file: text.txt}\n',
        "clip.flac": (resources.files("lipservo.clips") / "welcome.flac").read_bytes(),
        "plan.csv": "pose,jaw_deg\n1,zzz\n",
        "good_plan.csv": ",".join(plan) + "\n" + ",".join(["1", *["0"] * len(joints)]) + "\n",
        "markers.csv": "pose,marker,x_mm,y_mm,z_mm\n1,chin,0,0,zero\n",
        "half_line": "this file is somebody's own, and its last line has no end",
        "log.jsonl": '{"step": 1, "loss": 2.0}\n',
    }
    for name, content in contents.items():
        (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    np.save(folder / "array.npy", np.zeros(3))
    np.savez(folder / "other.npz", a=np.zeros(3))
    np.savez(folder / "about.npz", about=np.frombuffer(b'{"version": 3}', np.uint8))
    for name in ("folder", "corpus", "\udcfffolder"):
        (folder / name).mkdir()
    os.mkfifo(folder / "pipe")
    (folder / "loop").symlink_to("loop")
    (folder / "link_to_face.yaml").symlink_to("face.yaml")


def _is_joint(line: str) -> bool:
    """A key below `servos:` in a calibration, with nothing behind it."""
    return line.startswith("  ") and line[2] != " " and line.endswith(":")


def run(line: str, folder: Path) -> Outcome:
    """What `lipservo` makes of a line of the table, in a folder of `make_files`."""
    command, _, typed = line.partition(" <<< ")
    arguments = [
        word.replace("%FF", "\udcff").replace("LONG", "n" * 300) for word in shlex.split(command)
    ]
    before = _contents(folder)
    status: object = None
    with _standard_streams(typed.encode().decode("unicode_escape")) as stderr:
        old_arguments, sys.argv = sys.argv, ["lipservo", *arguments]
        try:
            with contextlib.chdir(folder):
                command_line.main()
        except SystemExit as end:
            status = end.code or 0
        except BaseException:
            traceback.print_exc()
        finally:
            sys.argv = old_arguments
    after = _contents(folder)
    changed = [name for name in before | after if before.get(name) != after.get(name)]
    return Outcome(status, stderr.getvalue(), changed)


@contextlib.contextmanager
def _standard_streams(typed: str) -> Iterator[io.StringIO]:
    stderr = io.StringIO()
    old_stdin, sys.stdin = sys.stdin, io.StringIO(typed)
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(stderr):
            yield stderr
    finally:
        sys.stdin = old_stdin


def _contents(folder: Path) -> dict[str, object]:
    """Every path below the folder, and what tells that it was written; folders only that."""
    found = {}
    for path in folder.rglob("*"):
        told = path.lstat()
        is_folder = path.is_dir() and not path.is_symlink()
        found[str(path)] = () if is_folder else (told.st_ino, told.st_size, told.st_mtime_ns)
    return found
