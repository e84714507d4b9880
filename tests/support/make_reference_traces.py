"""Writes tests/data/traces/*.jsonl.gz anew: `make traces`, when motion has changed on purpose."""

import gzip
import json
import tempfile
from pathlib import Path

from places import DATA
from reference_sounds import SOUNDS, write_sound

from firmware_bridge.clock import ManualClock
from lipservo.runtime.face_runtime import run_face
from lipservo.runtime.run_request import RunRequest, Sound
from lipservo.runtime.sound import open_sound

FOLDER = DATA / "traces"
#: All that `lipservo trace diff` looks at.
_KEPT = ("sound_s", "phoneme", "coefficients", "sent_deg")


def replay(name: str, folder: Path) -> Path:
    """The trace of one of the sounds, as `lipservo replay --trace` leaves it."""
    sound, trace = folder / f"{name}.wav", folder / f"{name}.jsonl"
    write_sound(name, sound)
    request = RunRequest(
        "face_sim", Sound("file", str(sound)), rate_hz=SOUNDS[name], trace=trace, quiet=True
    )
    with open_sound(request.sound) as source:
        run_face(request, source, ManualClock())
    return trace


def main() -> None:
    """Replay the three, keep what is compared."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        for name in SOUNDS:
            head, *ticks, end = [
                json.loads(line) for line in replay(name, Path(folder)).read_text().splitlines()
            ]
            kept = [head, *({key: tick[key] for key in _KEPT} for tick in ticks), end]
            text = "".join(json.dumps(each, separators=(",", ":")) + "\n" for each in kept)
            # No time of writing inside: the same motion gives the same bytes.
            packed = gzip.compress(text.encode(), 9, mtime=0)
            (FOLDER / f"{name}.jsonl.gz").write_bytes(packed)


if __name__ == "__main__":
    main()
