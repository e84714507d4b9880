"""Half a second of a tone through the face of this job; it is found by `LIPSERVO_RUNTIME`.

LIPSERVO_RUNTIME=/tmp/job python examples/ci/speak.py ws://127.0.0.1:8765
"""

import math
import struct
import sys

from lipservo_client import connect


def speak(url: str) -> None:
    """Speak a tone of 12,000 samples at 24 kHz."""
    tone = struct.pack("<12000h", *(int(9000 * math.sin(i / 9)) for i in range(12000)))
    with connect(url) as face, face.stream(24_000, playback="client") as speech:
        speech.write(tone)
        speech.report_played(0.5)


if __name__ == "__main__":
    speak(sys.argv[1])
