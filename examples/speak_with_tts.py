"""Any text to speech that gives PCM speaks through a running face.

Start:  python examples/speak_with_tts.py [TEXT] [URL]

URL is where a face takes speech, ws://127.0.0.1:8765 without one. espeak-ng synthesises where it is
installed; elsewhere a tone stands for a voice. Printed is how much of it was heard.
"""

import io
import math
import shutil
import struct
import subprocess
import sys
import wave

from lipservo_client.protocol import FaceError

import lipservo


def synthesised(text: str) -> tuple[bytes, int]:
    """The text as s16le mono, and its sample rate in Hz."""
    if shutil.which("espeak-ng") is None:
        tone = (int(8_000 * math.sin(0.05 * n)) for n in range(24_000))
        return b"".join(struct.pack("<h", sample) for sample in tone), 24_000
    done = subprocess.run(["espeak-ng", "--stdout", text], capture_output=True, check=True)
    with wave.open(io.BytesIO(done.stdout)) as sound:
        return sound.readframes(sound.getnframes()), sound.getframerate()


def main(text: str, url: str) -> None:
    """Say the text, and wait until it was heard."""
    pcm, sample_rate = synthesised(text)
    with lipservo.connect(url) as face, face.stream(sample_rate) as speech:
        for first in range(0, len(pcm), 4_000):
            speech.write(pcm[first : first + 4_000])
        played = speech.wait()
    print(f"heard {played.played_s:.2f} s, {'to the end' if played.finished else 'cut off'}")


if __name__ == "__main__":
    given = dict(enumerate(sys.argv))
    try:
        main(given.get(1, "Hello, I am a face."), given.get(2, "ws://127.0.0.1:8765"))
    except FaceError as error:
        sys.exit(f"the face: {error}")
