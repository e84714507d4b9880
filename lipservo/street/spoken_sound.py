"""The sound of a robot that speaks: loudspeaker, microphone, and what it is to say first."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from importlib import resources
from pathlib import Path

from lipservo.face.assembly import load_settings
from lipservo.street.run_request import RunRequest
from lipservo.street.sources import DEFAULT_MICROPHONE, Sound, open_microphone, open_sound
from lipservo.street.speech_queue import SpeechQueue, Spoken, spoken_file, spoken_text
from lipservo.street.voice_options import DEFAULT_OUTPUT, VoiceOptions
from lipsync.audio.half_duplex import ListenedMicrophone
from lipsync.audio.playout import Playout
from lipsync.audio.source import AudioSource, Loudspeaker


@contextmanager
def entered_sound(request: RunRequest, start_s: float = 0.0) -> Iterator[AudioSource]:
    """The sound of a request, entered: a source that is only heard, or a `Playout`.

    start_s: the sound time at which a file is taken up. Raises SoundError.
    """
    request = replace(request, sound=_of_the_face(request))
    if request.voice is None:
        with open_sound(request.sound, start_s) as source:
            yield source
        return
    with ExitStack() as stack:
        loudspeaker = _entered_loudspeaker(request.config, request.voice, stack)
        microphone = None
        if request.sound.kind == "microphone":
            device = stack.enter_context(open_microphone(request.sound.name))
            microphone = ListenedMicrophone(device)
        playout = Playout(loudspeaker, microphone)
        first = _first_words(request.sound, playout, start_s, stack)
        if first is not None:
            queue = SpeechQueue(playout)
            stack.callback(queue.close)
            queue.add(first, request.sound.name)
        yield playout


def check_sound(request: RunRequest) -> None:
    """Refuse now what `entered_sound` would refuse later, without opening a device."""
    if request.sound.kind == "file":
        open_sound(request.sound)


def _of_the_face(request: RunRequest) -> Sound:
    """The default microphone is the one that the face's YAML names, if it names one."""
    sound = request.sound
    if (sound.kind, sound.name) != ("microphone", DEFAULT_MICROPHONE):
        return sound
    return replace(sound, name=load_settings(request.config)[0].sound.input or DEFAULT_MICROPHONE)


def _entered_loudspeaker(config: str, voice: VoiceOptions, stack: ExitStack) -> Loudspeaker | None:
    if voice.output is None:
        return None
    from lipsync.audio.loudspeaker import LoudspeakerOutput

    settings = load_settings(config)[0].sound
    device = settings.output if voice.output == DEFAULT_OUTPUT else voice.output
    return stack.enter_context(LoudspeakerOutput(device, settings.output_offset_ms))


def _first_words(sound: Sound, playout: Playout, start_s: float, stack: ExitStack) -> Spoken | None:
    if sound.kind == "text":
        return spoken_text(sound.name, sound.language, playout)
    if sound.kind not in ("file", "clip"):
        return None
    path = Path(sound.name)
    if sound.kind == "clip":
        clip = resources.files("lipservo.clips") / "welcome.flac"
        path = stack.enter_context(resources.as_file(clip))
    phonemes = Path(sound.phonemes) if sound.phonemes else None
    return spoken_file(path, playout, start_s=start_s, phonemes=phonemes)[0]
