"""The speech side of a requested face with its recogniser and synthesiser, and its status."""

from collections.abc import Callable, Mapping

from firmware_bridge.loop.targets import TargetChannel
from lipservo.runtime.motion_options import make_synthesizer
from lipservo.runtime.requested_face import RequestedFace
from lipservo.runtime.speech.speech_side import SpeechSide, make_speech_side
from lipservo.runtime.status.face_status import SpeechStatus
from lipservo.runtime.status.live_board import LiveBoard
from lipservo.settings.motion_names import LIP_GAP_OFFSET
from lipsync.audio.playout import Playout
from lipsync.audio.source import AudioSource
from lipsync.face.frame import Synthesizer
from lipsync.recognition.recognizers import make_recognizer, no_recognizer
from lipsync.text_to_speech.pronunciation import spoken_words


class FaceSpeech:
    """The sound source, recogniser and speech side of a requested face, and their status."""

    def __init__(
        self,
        requested: RequestedFace,
        source: AudioSource,
        channel: TargetChannel,
        *,
        board: LiveBoard | None = None,
        timer_s: Callable[[], float] | None = None,
        synthesizer: Synthesizer | None = None,
    ) -> None:
        """Build recogniser, synthesiser and speech side. source: an entered audio source.

        channel: carries the servo targets to the bridge. board: memory for watchers, to write
        what is shown; None: none. timer_s: clock in seconds by which the recogniser notices that it
        falls behind the sound; None: it never checks. synthesizer: used without any recogniser;
        None: both are made as the request's motion names them.
        """
        face, motion = requested.face, requested.request.motion
        if synthesizer is None:
            self.recognizer = make_recognizer(
                motion.engine, timer_s, motion.weights, motion.recognizer_latency_s
            )
            synthesizer = make_synthesizer(face.model, motion, requested.request.model)
            if text := requested.request.sound.text:
                self.recognizer.tell(spoken_words(text))
        else:
            self.recognizer = no_recognizer()
        self.source = source
        self.side: SpeechSide = make_speech_side(
            face,
            source,
            self.recognizer,
            synthesizer,
            channel,
            start_s=requested.settings.capabilities.start_s(len(requested.settings.servos)),
            board=board,
        )
        self._motion = motion
        closing = face.calibration.closing
        self._mouth_closes = None if closing is None else closing.closes

    def status(self, settings: Mapping[str, float], listens_on: str | None = None) -> SpeechStatus:
        """Return the present status of the speech side.

        settings: settings changed since the start, by name. listens_on: URL at which voice agents
        are served; None: none are.
        """
        motion, source, speech = self._motion, self.source, self.side.speech
        playout = source if isinstance(source, Playout) else None
        output = None if playout is None else playout.loudspeaker
        expression = speech.expression
        style = motion.style_settings
        words, word = speech.saying
        named: dict[str, str] = {
            "recognizer": self.recognizer.level,
            "engine": motion.engine,
            "weights": motion.weights,
            "strategy": motion.strategy,
        }
        # Neither recogniser nor strategy works while a performance is played.
        if motion.performed:
            named = {**dict.fromkeys(named, "none"), "strategy": "performed"}
        return SpeechStatus(
            **named,
            sound=source.name,
            fallback_level=len(self.recognizer.reasons),
            fallback_reasons=self.recognizer.reasons,
            hears=speech.hearing,
            moved_by=speech.moved_by,
            units_shifted_ms=speech.units_shifted_ms,
            words=words,
            # By the sound alone it is not known which word is spoken.
            word=word if words and speech.moved_by != "sound" else None,
            settings={
                **{name: settings.get(name, value) for name, value in style.items()},
                **({} if speech.lip_gap is None else {LIP_GAP_OFFSET: speech.lip_gap.wanted_mm}),
            },
            delay_ms=round(speech.delay.total_s * 1e3, 3),
            n_phonemes=speech.phonemes_planned,
            n_lost_sound_blocks=source.lost_blocks,
            output=None if output is None else output.name,
            output_lost=None if output is None else output.is_lost,
            listens_on=listens_on,
            speaking=None if playout is None else playout.speaking,
            n_playout_underruns=None if playout is None else playout.n_underruns,
            arousal=None if expression is None else round(expression.arousal, 3),
            mouth_closes=self._mouth_closes,
            is_resting=None if expression is None else expression.is_resting,
            expression={} if expression is None else expression.requests.values,
        )
