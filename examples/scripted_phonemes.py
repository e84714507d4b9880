"""Phonemes from a script move the mouth: no sound, no recogniser, no servos.

Start:  python examples/scripted_phonemes.py

Printed is a line every 40 ms: the time, the phoneme, the distance of the inner lips in mm, and the
jaw's angle in degrees. The lips come within a millimetre in the B and in the M. Any other source
of phonemes (a speech synthesiser's marks, a TextGrid) takes the place of `WORD` in the same way.
"""

from lipservo.runtime.motion_options import MotionOptions, make_synthesizer
from lipservo.runtime.servos.assembly import assemble_face
from lipsync.phonemes import PhonemeEvent
from lipsync.recognition.scripted import ScriptedPhonemes

#: "bomb": each phoneme with its start and its end in seconds.
WORD = (
    PhonemeEvent("SIL", 0.0, 0.2),
    PhonemeEvent("B", 0.2, 0.32),
    PhonemeEvent("AA", 0.32, 0.56),
    PhonemeEvent("M", 0.56, 0.72),
    PhonemeEvent("SIL", 0.72, 1.2),
)
STEP_S = 0.04


def main() -> None:
    """Tell the synthesiser what is known at each moment, and ask it for the face of the moment."""
    face = assemble_face("face_sim", None)
    jaw = face.calibration.servo_names.index("jaw")
    synthesizer = make_synthesizer(face.model, MotionOptions())
    script = ScriptedPhonemes(WORD, synthesizer.lookahead_s)
    for n in range(30):
        time_s = n * STEP_S
        for update in script.updates(time_s):
            synthesizer.push(update)
        coefficients = synthesizer.frame_at(time_s).coefficients
        event = synthesizer.event_at(time_s)
        gap_mm = face.model.lip_gap_mm(coefficients)
        jaw_deg = face.calibration.positions_deg(coefficients)[jaw]
        phoneme = "SIL" if event is None else event.phoneme
        print(f"{time_s:4.2f} s  {phoneme:3}  lips {gap_mm:4.1f} mm  jaw {jaw_deg:5.1f} deg")


if __name__ == "__main__":
    main()
