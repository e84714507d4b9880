"""A simulated face speaks a recording, as fast as the computer goes.

Start:  python examples/speak_recording.py [RECORDING]

RECORDING is a sound file; without one the bundled clip speaks. Printed are the sound's length, how
many phonemes moved the mouth, how many goals every servo got, and how far behind the sound a live
face would be. With `MonotonicClock()` in place of `ManualClock()` the face moves in real time.
"""

import sys
from pathlib import Path

from firmware_bridge.clock import ManualClock
from lipservo.runtime.face_runtime import run_face
from lipservo.runtime.run_request import CLIP, RunRequest, Sound
from lipservo.runtime.sound import open_sound


def main(recording: Path | None) -> None:
    """Play the recording through recogniser, synthesiser, calibration, gate and servos."""
    sound = CLIP if recording is None else Sound("file", str(recording))
    request = RunRequest("face_sim", sound, quiet=True)
    with open_sound(sound) as source:
        summary = run_face(request, source, ManualClock()).summary
    print(f"{summary.source}: {summary.duration_s:.2f} s of sound")
    print(f"{summary.phonemes} phonemes moved the mouth")
    print(f"{summary.frames_sent} goals were sent to every servo")
    print(f"a live face is {summary.latency_declared_ms:.0f} ms behind the sound")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
