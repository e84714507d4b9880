"""Voice agents at a face: where they are waited for, and what they may ask."""

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final

from lipservo.access.token_file import read_token
from lipservo.agents.listener import bind_listener, url_of
from lipservo.speech.performed_line import PerformedStream, performed_line
from lipservo.street.sources import warn
from lipservo.street.spoken_file import SpokenChunks, SpokenFile
from lipservo.street.spoken_text import SpokenWords
from lipservo.street.voice_options import DEFAULT_LISTEN, VoiceOptions
from lipsync.audio.playout import Playout
from lipsync.errors import UserError
from lipsync.face.model import FaceModel
from lipsync.offline.performance_file import SUFFIX, read_performance

if TYPE_CHECKING:
    import socket

    from lipservo.speech.speech_side import SpeechSide

#: Texts and files that agents let the face say; the oldest are over by then.
_MOST_SPOKEN: Final = 64
#: Performances that are said or wait: each is kept whole, up to five minutes of sound.
_MOST_PERFORMED: Final = 8


def bound_listener(listen: str | None, token_file: str | None) -> "socket.socket | None":
    """Where voice agents connect.

    listen: HOST:PORT; `none`: nowhere; None: the usual port, or any that is free where another face
    has it. Raises UserError.
    """
    if listen == "none":
        return None
    token = read_token(token_file)
    if listen is not None:
        return bind_listener(listen, token)
    try:
        return bind_listener(DEFAULT_LISTEN, token)
    except UserError:
        return bind_listener(f"{DEFAULT_LISTEN.rpartition(':')[0]}:0", token)


@contextmanager
def voice_agents(
    listener: "socket.socket | None",
    side: "SpeechSide",
    options: VoiceOptions | None,
    model: FaceModel,
    control_path: Path,
    log: Callable[[str], None],
) -> Iterator[str | None]:
    """Serve voice agents at a listener that is bound; the address. None: nobody is waited for.

    model: of the face, which performances must be rendered for.
    """
    if listener is None or side.voice is None or options is None:
        yield None
        return
    from lipservo.access.admission import Policy
    from lipservo.agents.agent_server import AgentServer
    from lipservo.agents.agent_settings import AgentSettings

    try:
        token = read_token(options.token_file)
    except UserError as error:
        # It was there when the face was started: this process is a later one, and the face goes on.
        log(f"voice agents: none are served: {error}")
        yield None
        return
    voice, delay = side.voice, side.speech.delay
    spoken = _Spoken(voice.playout, options, model)
    url = url_of(listener)
    with AgentServer(
        listener,
        voice.playout,
        control_path=control_path,
        delay_ms=lambda: delay.total_s * 1e3,
        settings=AgentSettings(
            policy=Policy(token, tuple(each for each in options.origins.split(",") if each)),
            when_busy="queue" if options.queue else "refuse",
        ),
        say=spoken.say,
        play=spoken.play if options.sounds is not None else None,
        log=log,
    ) as server:
        voice.phonemes = server.phonemes
        try:
            yield url
        finally:
            spoken.close()


class _Spoken:
    """What agents let the face say besides their streams."""

    def __init__(self, playout: Playout, options: VoiceOptions, model: FaceModel) -> None:
        self._playout = playout
        self._model = model
        self._folder = Path(options.sounds or ".").resolve()
        self._spoken: deque[SpokenWords | SpokenChunks] = deque(maxlen=_MOST_SPOKEN)
        self._performed: deque[PerformedStream] = deque(maxlen=_MOST_PERFORMED)

    def say(self, text: str) -> Mapping[str, object]:
        """A text. Raises SynthesisError."""
        self._spoken.append(SpokenWords(text, "", self._playout))
        return {}

    def play(self, name: str) -> Mapping[str, object]:
        """A sound file or performance below the folder that the user allowed. Raises UserError."""
        path = (self._folder / name).resolve()
        if not path.is_relative_to(self._folder):
            raise UserError(f"{name}: lies outside the folder of sounds")
        if path.suffix.lower() == SUFFIX:
            return self._perform(path)
        self._spoken.append(SpokenFile(path, self._playout))
        return {}

    def _perform(self, path: Path) -> Mapping[str, object]:
        """All that can be wrong is told before the face hears of it."""
        waiting = [each for each in self._performed if not each.is_over]
        if len(waiting) == _MOST_PERFORMED:
            raise UserError(
                f"{path.name}: {_MOST_PERFORMED} performances are said or wait already; wait, or "
                "interrupt them"
            )
        performance = read_performance(path)
        performance.check_face(self._model, str(path))
        line = performed_line(performance, path, warn)
        stream = line.stream(self._playout)
        self._performed = deque([*waiting, stream], maxlen=_MOST_PERFORMED)
        self._spoken.append(SpokenChunks(line.chunks(), stream, self._playout))
        return {"stream": line.name, "duration_s": round(performance.duration_s, 3)}

    def close(self) -> None:
        """Nothing more is read or synthesised."""
        for each in self._spoken:
            each.close()
