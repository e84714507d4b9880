"""Clients of the dashboard's stream for the bench, until standard input closes."""

import asyncio
import sys

from websockets.asyncio.client import ClientConnection, connect


async def read_streams(address: str, path: str, n: int) -> None:
    """Read a stream with `n` WebSocket clients until standard input closes.

    Prints `connected` once all clients have received something.
    """
    url = f"{address.replace('http://', 'ws://', 1)}{path}"
    sockets = [await connect(url, compression=None, proxy=None) for _ in range(n)]
    for socket in sockets:
        await socket.recv()
    sys.stdout.write("connected\n")
    sys.stdout.flush()
    async with asyncio.TaskGroup() as group:
        readers = [group.create_task(_read(socket)) for socket in sockets]
        await asyncio.to_thread(sys.stdin.read)
        for reader in readers:
            reader.cancel()


async def _read(socket: ClientConnection) -> None:
    async for _ in socket:
        pass


if __name__ == "__main__":
    asyncio.run(read_streams(sys.argv[1], sys.argv[2], int(sys.argv[3])))
