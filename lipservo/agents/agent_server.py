"""The WebSocket server that voice agents connect to: one thread beside the loop that moves servos.

docs/agents.md describes the protocol.
"""

import asyncio
import contextlib
import json
import logging
import socket
import threading
import time
from collections.abc import AsyncIterator, Callable
from concurrent.futures import ThreadPoolExecutor
from http import HTTPStatus
from pathlib import Path
from typing import Final, Self
from urllib.parse import urlsplit

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from lipservo.access.doorway import ACCEPTED, BACKLOG, HEAD_S, MOST_HEADS, Doorway, scaled
from lipservo.agents.control_session import Commands, ControlSession
from lipservo.agents.listener import (
    HEALTH_PATHS,
    PROTOCOL_PATH,
    STREAM_PATH,
    AgentSettings,
    Handshake,
    PlayFile,
    SayText,
    handshake,
    request_of,
    url_of,
)
from lipservo.agents.messages import Outbox
from lipservo.agents.stream_session import StreamSession
from lipservo.agents.turns import OpenStreams
from lipsync.audio.playout import Playout

#: Events of the playout are read so often.
_POLL_S: Final = 0.01
#: At the end so many reads, for how much was played; the loop that plays needs one tick for that,
#: if it still runs.
_LAST_POLLS: Final = 30
#: Longest wait for a client that hangs, at the end or when it is disconnected.
_CLOSING_S: Final = 1.0
#: Longest wait for the server's thread; after that it is left to die with the process.
_JOIN_S: Final = 5.0
#: Clients that may only stop the face (without a token, or beyond the number that settings allow),
#: once they have sent a message; for another one the oldest is disconnected.
_MOST_STOPPERS: Final = 16
_GOING_AWAY, _POLICY_VIOLATION = 1001, 1008
_LOG: Final = logging.getLogger(__name__)
#: Swallows the library's log lines, which are for its developers and name what clients requested.
_SILENT: Final = logging.Logger("websockets of agents", logging.CRITICAL + 1)


def _connection_class(heads: Doorway, stoppers: Doorway) -> type[ServerConnection]:
    """Return a class of connections, each of which counts as waiting in `heads` from its start.

    heads: limits the connections whose first message is awaited. stoppers: limits those that may
    only stop the face. At its end a connection leaves both.
    """

    class Connection(ServerConnection):
        def connection_made(self, transport: asyncio.BaseTransport) -> None:
            super().connection_made(transport)
            heads.enter(self.transport)

        def connection_lost(self, exc: Exception | None) -> None:
            super().connection_lost(exc)
            heads.leave(self.transport)
            stoppers.leave(self.transport)

    return Connection


class AgentServer:
    """A WebSocket server for voice agents that runs in its own thread inside a `with` block."""

    def __init__(
        self,
        listener: socket.socket,
        playout: Playout,
        *,
        control_path: Path,
        delay_ms: Callable[[], float],
        settings: AgentSettings | None = None,
        say: SayText | None = None,
        play: PlayFile | None = None,
    ) -> None:
        """Prepare the server; entering its `with` block starts it.

        listener: a socket from `bind_listener`, closed when the server ends. playout: plays the
        clients' speech. control_path: of the face's control socket. delay_ms: returns the present
        delay in ms from the arrival of sound to the motion that shows it. settings: limits of
        clients and streams. say, play: speak a text or play a sound file; None: not available.
        """
        self._listener = listener
        self._url = url_of(listener)
        self._playout = playout
        self._delay_ms = delay_ms
        self._settings = settings or AgentSettings()
        self._streams = OpenStreams(playout, self._settings)
        self._n_clients = 0
        self._heads = Doorway(MOST_HEADS, HEAD_S)
        self._stoppers = Doorway(_MOST_STOPPERS)
        self._commands = Commands(
            control_path,
            say,
            play,
            ThreadPoolExecutor(2, thread_name_prefix="agent status"),
            ThreadPoolExecutor(2, thread_name_prefix="agent command"),
            ThreadPoolExecutor(1, thread_name_prefix="agent say"),
        )
        self._loop: asyncio.AbstractEventLoop | None = None
        self._stopping = asyncio.Event()
        self._started = threading.Event()
        self._thread = threading.Thread(target=self._run, name="agents", daemon=True)

    def status(self) -> dict[str, object]:
        """Return the server's URL and its numbers of clients and refused streams; never wait."""
        return {
            "url": self._url,
            "n_clients": self._n_clients,
            "n_streams_refused": self._streams.n_refused,
        }

    def __enter__(self) -> Self:
        self._thread.start()
        self._started.wait(_JOIN_S)
        return self

    def __exit__(self, *exc: object) -> None:
        """End all streams, close the connections, and wait at most 5 s for the thread's end."""
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):  # it has ended by itself
                self._loop.call_soon_threadsafe(self._stopping.set)
        self._thread.join(_JOIN_S)
        commands = self._commands
        for pool in (commands.statuses, commands.changes, commands.speaking):
            pool.shutdown(wait=False, cancel_futures=True)

    def _run(self) -> None:
        """Run the server until it is stopped; log an exception that ends it.

        Runs in thread `agents`. `_started` is set after a failure as well, so that `__enter__` does
        not wait for its timeout.
        """
        try:
            asyncio.run(self._serve())
        except Exception as error:
            _LOG.error("voice agents: the server has ended: %s: %s", type(error).__name__, error)
        finally:
            self._started.set()
            self._listener.close()

    async def _serve(self) -> None:
        """Serve WebSocket clients until `_stopping` is set, then close all connections.

        Before the connections close, all speech is interrupted, and clients are sent how much of
        their speech was played; this takes 0.3 s at most.
        """
        self._loop = asyncio.get_running_loop()
        server = await serve(
            self._serve_client,
            sock=self._listener,
            process_request=self._admit,
            create_connection=_connection_class(self._heads, self._stoppers),
            backlog=scaled(ACCEPTED),
            compression=None,
            server_header=None,
            max_size=self._settings.most_message_bytes,
            ping_interval=self._settings.ping_s,
            ping_timeout=2.0 * self._settings.ping_s,
            close_timeout=0.5 * _CLOSING_S,  # with the pings less than ten seconds
            logger=_SILENT,
        )
        self._listener.listen(BACKLOG)
        _LOG.info("voice agents: %s", self._url)
        self._started.set()
        sending_news = self._loop.create_task(self._send_news())
        await self._stopping.wait()
        self._streams.end_all()
        # Each client is sent how much of its speech was played before it is disconnected.
        for _ in range(_LAST_POLLS):
            await asyncio.sleep(_POLL_S)
            if not self._streams.playing:
                break
        sending_news.cancel()
        await _close_all(server)

    def _admit(self, connection: ServerConnection, request: Request) -> Response | None:
        """Return the HTTP answer to an opening request; None: the WebSocket connection is opened.

        Called by the websockets library as `process_request`. A refused request gets its HTTP
        error; a plain GET gets the server's status or the protocol's schema.
        """
        try:
            refused = self._handshake(connection, request).refused
        except ValueError:
            return connection.respond(HTTPStatus.BAD_REQUEST, "the request cannot be read\n")
        if refused is not None:
            return connection.respond(refused.status, f"{refused.text}\n")
        path = urlsplit(request.path).path
        if path in HEALTH_PATHS:
            return connection.respond(HTTPStatus.OK, f"{json.dumps(self.status())}\n")
        if path == PROTOCOL_PATH:
            from lipservo.agents.protocol_schema import protocol_schema

            return connection.respond(HTTPStatus.OK, f"{json.dumps(protocol_schema())}\n")
        return None

    def _handshake(self, connection: ServerConnection, request: Request) -> Handshake:
        """Return whether a request gets full, stop-only or no access; ValueError if malformed."""
        peer = (connection.remote_address or ("",))[0]
        opening = request_of(request.path, request.headers.raw_items(), peer)
        return handshake(opening, self._settings, self._n_clients)

    async def _serve_client(self, connection: ServerConnection) -> None:
        """Serve one client until it disconnects, or disconnect it because it reads too slowly."""
        assert connection.request is not None
        outbox = Outbox()
        session: StreamSession | ControlSession
        may_only_stop = self._handshake(connection, connection.request).may_only_stop
        if urlsplit(connection.request.path).path == STREAM_PATH:
            session = StreamSession(outbox, self._streams, self._playout, self._delay_ms)
        else:
            session = ControlSession(outbox, self._commands, self._streams, may_only_stop)
        # Connections that may only stop the face do not count as clients.
        is_client = may_only_stop is None
        if is_client:
            self._heads.leave(connection.transport)
        self._n_clients += is_client
        sending = asyncio.ensure_future(_send_queued(connection, outbox))
        ending_tasks = [
            asyncio.ensure_future(each)
            for each in (self._pass_messages(connection, session, outbox), outbox.overflowed.wait())
        ]
        try:
            # Not until sending fails: a client that has gone may have sent more, for example `end`.
            await asyncio.wait(ending_tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._n_clients -= is_client
            is_slow = outbox.overflowed.is_set()
            session.leave()
            for task in (*ending_tasks, sending):
                task.cancel()
            if is_slow:
                await connection.close(_POLICY_VIOLATION, "slow_reader: events were not read")

    async def _pass_messages(
        self, connection: ServerConnection, session: StreamSession | ControlSession, outbox: Outbox
    ) -> None:
        """Pass each message of a client to its session, until the client disconnects.

        A session's exception is logged and sent to the client as the error `internal`; the
        connection stays open. Messages beyond `messages_per_s` wait.
        """
        rate = MessageRate(self._settings.messages_per_s)
        async for message in self._received_messages(connection):
            try:
                await session.hear(message)
            except Exception as error:
                # A fault of ours: this client gets an error, and the others go on.
                _LOG.error("voice agents: a message failed: %s: %s", type(error).__name__, error)
                outbox.error("internal", "the message failed; see the face's log")
            await asyncio.sleep(rate.wait_s(time.monotonic()))

    async def _received_messages(self, connection: ServerConnection) -> AsyncIterator[str | bytes]:
        """Yield a client's messages; close its connection if none comes in `first_message_s`."""
        try:
            async with asyncio.timeout(self._settings.first_message_s):
                first = await connection.recv()
        except TimeoutError:
            await connection.close(_POLICY_VIOLATION, "no_start: send hello or start first")
            return
        except ConnectionClosed:
            return
        if self._heads.leave(connection.transport):
            self._stoppers.enter(connection.transport)
        yield first
        with contextlib.suppress(ConnectionClosed):
            async for message in connection:
                yield message

    async def _send_news(self) -> None:
        """Send clients events of playing, and positions every `position_s`, until cancelled."""
        positions_sent_s = 0.0
        while True:
            now_s = time.monotonic()
            is_due = now_s - positions_sent_s >= self._settings.position_s
            positions_sent_s = now_s if is_due else positions_sent_s
            try:
                self._send_news_once(now_s, positions=is_due)
            except Exception as error:
                # A fault of ours: go on, or clients would wait for the end of a stream for ever.
                _LOG.error("voice agents: telling failed: %s: %s", type(error).__name__, error)
                await asyncio.sleep(_CLOSING_S)
            await asyncio.sleep(_POLL_S)

    def _send_news_once(self, now_s: float, *, positions: bool) -> None:
        """Send clients all new events and phonemes of the playout; with `positions` also these."""
        self._streams.take_events(now_s)
        while self._playout.phonemes:
            self._streams.tell_phoneme(*self._playout.phonemes.popleft())
        if positions:
            self._streams.end_stalled(now_s)
            self._streams.tell_positions()


async def _send_queued(connection: ServerConnection, outbox: Outbox) -> None:
    """Send a client the events of its outbox, as they come, until it disconnects."""
    with contextlib.suppress(ConnectionClosed):
        while True:
            await connection.send(await outbox.take())


async def _close_all(server: Server) -> None:
    """Close the clients' connections, then the server; wait at most 2 s for each of the two."""
    clients = server.connections
    closings = [asyncio.ensure_future(each.close(_GOING_AWAY, "shutting_down")) for each in clients]
    if closings:
        await asyncio.wait(closings, timeout=2.0 * _CLOSING_S)
    server.close()
    with contextlib.suppress(TimeoutError):
        await asyncio.wait_for(server.wait_closed(), 2.0 * _CLOSING_S)


class MessageRate:
    """A limit of a client's message rate, which lets bursts of one second's worth pass."""

    def __init__(self, per_s: float) -> None:
        self._per_s = per_s
        self._n_allowed = per_s
        self._refilled_s = 0.0

    def wait_s(self, now_s: float) -> float:
        """Count one message, at monotonic `now_s`; return the s to wait before reading the next."""
        if self._refilled_s:
            n_new = (now_s - self._refilled_s) * self._per_s
            self._n_allowed = min(self._per_s, self._n_allowed + n_new)
        self._refilled_s = now_s
        self._n_allowed -= 1.0
        return max(0.0, -self._n_allowed / self._per_s)
