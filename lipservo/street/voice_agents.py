"""Voice agents at a face: where they are waited for, and what they may ask."""

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final

from lipservo.agents.listener import bind_listener, url_of
from lipservo.street.spoken_file import SpokenFile
from lipservo.street.spoken_text import SpokenWords
from lipservo.street.voice_options import DEFAULT_LISTEN, VoiceOptions
from lipsync.audio.playout import Playout
from lipsync.errors import UserError

if TYPE_CHECKING:
    import socket

    from lipservo.speech.speech_side import SpeechSide

#: Texts and files that agents let the face say; the oldest are over by then.
_MOST_SPOKEN: Final = 64


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


def read_token(token_file: str | None) -> str | None:
    """The first line of a file, which voice agents must know. Raises UserError."""
    if token_file is None:
        return None
    try:
        with Path(token_file).open(encoding="utf-8") as file:
            token = file.readline().strip()
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{token_file}: cannot be read as a token: {error}") from error
    if not token:
        raise UserError(f"{token_file}: its first line is empty; write a token there")
    return token


@contextmanager
def voice_agents(
    listener: "socket.socket | None",
    side: "SpeechSide",
    options: VoiceOptions | None,
    control_path: Path,
    log: Callable[[str], None],
) -> Iterator[str | None]:
    """Serve voice agents at a listener that is bound; the address. None: nobody is waited for."""
    if listener is None or side.voice is None or options is None:
        yield None
        return
    from lipservo.agents.agent_server import AgentServer
    from lipservo.agents.agent_settings import AgentSettings

    voice, delay = side.voice, side.speech.delay
    spoken = _Spoken(voice.playout, options)
    url = url_of(listener)
    with AgentServer(
        listener,
        voice.playout,
        control_path=control_path,
        delay_ms=lambda: delay.total_s * 1e3,
        settings=AgentSettings(
            token=read_token(options.token_file),
            allowed_origins=tuple(each for each in options.origins.split(",") if each),
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

    def __init__(self, playout: Playout, options: VoiceOptions) -> None:
        self._playout = playout
        self._folder = Path(options.sounds or ".").resolve()
        self._spoken: deque[SpokenWords | SpokenFile] = deque(maxlen=_MOST_SPOKEN)

    def say(self, text: str) -> Mapping[str, object]:
        """A text. Raises SynthesisError."""
        self._spoken.append(SpokenWords(text, "", self._playout))
        return {}

    def play(self, name: str) -> Mapping[str, object]:
        """A sound file below the folder that the user allowed. Raises UserError."""
        path = (self._folder / name).resolve()
        if not path.is_relative_to(self._folder):
            raise UserError(f"{name}: lies outside the folder of sounds")
        self._spoken.append(SpokenFile(path, self._playout))
        return {}

    def close(self) -> None:
        """Nothing more is read or synthesised."""
        for each in self._spoken:
            each.close()
