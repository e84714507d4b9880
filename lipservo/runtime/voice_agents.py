"""Serving voice agents of a face: the port to which they connect, and their requests."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from lipservo.access.token_file import read_token
from lipservo.agents.listener import bind_listener, url_of
from lipservo.agents.messages import MessageError, Play, Say
from lipservo.runtime.requested_face import RequestedFace
from lipservo.runtime.run_request import DEFAULT_LISTEN, VoiceOptions
from lipservo.runtime.sound import (
    QueueFullError,
    SpeechItem,
    SpeechQueue,
    spoken_chunks,
    spoken_file,
    spoken_text,
)
from lipservo.runtime.speech.performed_line import performed_line
from lipsync.audio.channels import channel_or_mix
from lipsync.audio.file import open_sound
from lipsync.audio.playout import Playout
from lipsync.errors import UserError
from lipsync.offline.performance import SUFFIX, read_performance

if TYPE_CHECKING:
    import socket

    from lipservo.runtime.speech.speech_side import SpeechSide

_LOG = logging.getLogger(__name__)


def bound_listener(listen: str | None, token_file: str | None) -> "socket.socket | None":
    """Return a socket on which voice agents can connect; None for `listen` = "none".

    listen: HOST:PORT; None: the default port, or any free one where another face has that.
    token_file: the token that agents must send; None: agents on this computer need none. Raises
    UserError.
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
    requested: RequestedFace,
) -> Iterator[str | None]:
    """Serve voice agents on a bound listener; yield its URL, or None if no agent is served.

    side: the speech side of the face, whose own voice plays the agents' speech; without one no
    agent is served. requested: the face, with the options for agents in its request.
    """
    options = requested.request.voice
    if listener is None or side.voice is None or options is None:
        yield None
        return
    from lipservo.access.admission import Policy
    from lipservo.agents.agent_server import AgentServer
    from lipservo.agents.listener import AgentSettings

    try:
        token = read_token(options.token_file)
    except UserError as error:
        # The file was there when the face was started, so this is a restarted process: go on.
        _LOG.warning("voice agents: none are served: %s", error)
        yield None
        return
    voice, delay = side.voice, side.speech.delay
    agent_speech = _AgentSpeech(voice.playout, options, requested)
    url = url_of(listener)
    with AgentServer(
        listener,
        voice.playout,
        control_path=requested.control_path,
        delay_ms=lambda: delay.total_s * 1e3,
        settings=AgentSettings(
            policy=Policy(token, tuple(each for each in options.origins.split(",") if each)),
            when_busy="queue" if options.queue else "refuse",
        ),
        say=agent_speech.say,
        play=agent_speech.play if options.sounds is not None else None,
    ):
        try:
            yield url
        finally:
            agent_speech.close()


class _AgentSpeech:
    """The texts and files that agents let the face speak besides their streams, in one queue."""

    def __init__(self, playout: Playout, options: VoiceOptions, requested: RequestedFace) -> None:
        self._playout = playout
        self._model = requested.face.model  # which performances must be rendered for
        self._speaker = requested.speaker
        self._channel = requested.settings.sound.channel
        self._folder = Path(options.sounds or ".").resolve()
        self._queue = SpeechQueue(playout)

    def say(self, given: Say, name: str) -> SpeechItem:
        """Queue a text, and return its speech, whose first sentence is synthesised.

        name: of its streams, one for each sentence. Raises SynthesisError, and MessageError if the
        queue is full.
        """
        self._check_room("text")
        speaker = self._speaker.changed(given.language, given.voice, given.rate_wpm, given.pitch)
        return self._queued(spoken_text(given.text, self._playout, speaker, name), "text")

    def play(self, given: Play, name: str) -> SpeechItem:
        """Queue a sound file or performance below the allowed folder, and return its speech.

        The file is checked first. name: of its stream. Raises UserError, and MessageError if the
        queue is full.
        """
        path = (self._folder / given.file).resolve()
        if not path.is_relative_to(self._folder):
            raise UserError(f"{given.file}: is outside the folder of sounds")
        # Before the file is read, which may be large, so that many refused requests cost little.
        self._check_room(path.name)
        if path.suffix.lower() == SUFFIX:
            performance = read_performance(path)
            performance.check_face(self._model, str(path))
            line = replace(performed_line(performance, path), name=name)
            stream = line.stream(self._playout)
            item = spoken_chunks(line.chunks(), stream, performance.duration_s)
        else:
            with open_sound(path) as sound:
                channel = channel_or_mix(self._channel, sound.channels)
            item = spoken_file(path, self._playout, name, channel=channel)
        return self._queued(item, path.name)

    def close(self) -> None:
        """Stop reading and synthesising the queued items."""
        self._queue.close()

    def _queued(self, item: SpeechItem, name: str) -> SpeechItem:
        self._queue.add(item, name)
        return item

    def _check_room(self, name: str) -> None:
        try:
            self._queue.check_room(name)
        except QueueFullError as error:
            raise MessageError("too_many_streams", str(error)) from error
