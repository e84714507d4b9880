"""A whole street whose phonemes are known beforehand, in place of sound and recogniser."""

from firmware_bridge.loop.targets import MemoryTargetChannel
from lipservo.runtime.motion_options import MotionOptions, make_synthesizer
from lipservo.runtime.servos.assembly import bridge_for
from lipservo.runtime.speech.speech import Speech, SpeechOptions
from lipservo.runtime.speech.speech_side import SpeechSide, mouth_plan
from lipservo.runtime.street import Street
from lipsync.audio.playback_clock import SteadyClock
from lipsync.recognition.scripted import ScriptedPhonemes


def scripted_street(face, events, bus, rate_hz):
    """For an entered bus; the mouth's joints are planned as in a running face."""
    synthesizer = make_synthesizer(face.model, MotionOptions())
    phonemes, names = ScriptedPhonemes(events), list(face.settings.servos)
    channel, options = MemoryTargetChannel(), SpeechOptions(plan=mouth_plan(face))
    speech = Speech(phonemes, SteadyClock(), synthesizer, face.calibration, names, channel, options)
    bridge = bridge_for(face.settings, bus, channel, rate_hz=rate_hz)
    return Street(SpeechSide(speech, rest=face.model.rest), bridge, face.model.rest)
