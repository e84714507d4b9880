"""A performance of the shipped face model, with a tone for its sound."""

import numpy as np
import soundfile

from lipsync.face.model import load_face
from lipsync.offline.performance import RATE_HZ, Performance, performed_sound, write_performance
from lipsync.phonemes import PhonemeEvent

SOUND_RATE_HZ = 16_000


def written_performance(path, duration_s=1.0, *, included=True, sound=None, **changes):
    """Its file at `path`, NAME.wav beside it; changes: of fields of `Performance`.

    sound: a file in place of the tone.
    """
    if sound is None:
        sound = path.with_suffix(".wav")
        times_s = np.arange(round(duration_s * SOUND_RATE_HZ)) / SOUND_RATE_HZ
        soundfile.write(sound, 0.3 * np.sin(2 * np.pi * 220 * times_s), SOUND_RATE_HZ)
    face = load_face()
    at_s = np.arange(round(duration_s * RATE_HZ) + 1) / RATE_HZ
    faces = np.tile(face.rest, (len(at_s), 1))
    faces[:, 0] += 12.0 * np.sin(2 * np.pi * 2.1 * at_s)
    given = {
        "face_checksum": face.checksum,
        "coefficients": faces.astype(np.float32),
        "phonemes": (PhonemeEvent("AA", 0.0, duration_s),),
        "sound": performed_sound(sound, included=included),
        "method": "heard",
    }
    write_performance(Performance(**{**given, **changes}), path)
    return path
