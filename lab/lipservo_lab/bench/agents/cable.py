"""A cable between agent and face that can be pulled: a TCP proxy in a thread."""

import asyncio
import contextlib
import threading
from typing import Final, Self

_JOIN_S: Final = 10.0


class Cable:
    """Carries connections to a port; while it is pulled nothing passes and none ends."""

    def __init__(self, to_port: int) -> None:
        self._to_port = to_port
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name="cable", daemon=True)
        self._plugged = asyncio.Event()
        self._started = threading.Event()
        self.port = 0

    def pull(self) -> None:
        """Let nothing pass from now on, until `plug`."""
        self._loop.call_soon_threadsafe(self._plugged.clear)

    def plug(self) -> None:
        """Pass bytes again, first those that were on their way."""
        self._loop.call_soon_threadsafe(self._plugged.set)

    def __enter__(self) -> Self:
        self._thread.start()
        self._started.wait(_JOIN_S)
        return self

    def __exit__(self, *exc: object) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(_JOIN_S)

    def _run(self) -> None:
        """Accept connections in the cable's thread until its loop is stopped; then close them."""
        asyncio.set_event_loop(self._loop)
        self._loop.run_until_complete(self._listen())
        self._started.set()
        self._loop.run_forever()
        self._server.close()
        tasks = asyncio.all_tasks(self._loop)
        for task in tasks:
            task.cancel()
        self._loop.run_until_complete(asyncio.gather(*tasks, return_exceptions=True))
        self._loop.close()

    async def _listen(self) -> None:
        self._plugged.set()
        self._server = await asyncio.start_server(self._relay, "127.0.0.1", 0)
        self.port = self._server.sockets[0].getsockname()[1]

    async def _relay(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Connect a client to the far port and copy bytes both ways until both directions end.

        A client that arrives while the cable is pulled waits; one whose far port refuses is closed.
        """
        try:
            await self._plugged.wait()
            far_reader, far_writer = await asyncio.open_connection("127.0.0.1", self._to_port)
        except OSError:
            writer.close()
            return
        await asyncio.gather(self._copy(reader, far_writer), self._copy(far_reader, writer))

    async def _copy(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Copy bytes of one direction until its end; hold both back while the cable is pulled."""
        try:
            while data := await reader.read(1 << 16):
                await self._plugged.wait()
                writer.write(data)
                await writer.drain()
        except OSError:
            pass
        finally:
            with contextlib.suppress(asyncio.CancelledError):
                await self._plugged.wait()  # its end does not pass either
            writer.close()
