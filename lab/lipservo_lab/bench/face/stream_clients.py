"""Clients of the dashboard's stream for the bench, until standard input closes."""

import asyncio
import json
import sys
import threading
import time

from websockets.asyncio.client import ClientConnection, connect


async def run(address: str, path: str, n: int) -> float:
    """Read a stream with `n` WebSocket clients until standard input closes; return bytes/s of one.

    Prints `connected` once all clients have received something. The result is the clients' mean.
    """
    url = f"{address.replace('http://', 'ws://', 1)}{path}"
    sockets = [await connect(url, compression=None, proxy=None) for _ in range(n)]
    for socket in sockets:
        await socket.recv()
    sys.stdout.write("connected\n")
    sys.stdout.flush()
    is_over = asyncio.Event()
    loop = asyncio.get_running_loop()

    def wait_for_input_end() -> None:
        sys.stdin.read()
        loop.call_soon_threadsafe(is_over.set)

    threading.Thread(target=wait_for_input_end, daemon=True).start()
    began_s = time.monotonic()
    readers = [asyncio.create_task(_count_bytes(socket, is_over)) for socket in sockets]
    n_bytes = sum(await asyncio.gather(*readers))
    return n_bytes / n / (time.monotonic() - began_s)


async def _count_bytes(socket: ClientConnection, is_over: asyncio.Event) -> int:
    # The header of a WebSocket frame of more than 125 bytes is four bytes, of a shorter one two.
    n_bytes = 0
    while not is_over.is_set():
        message = await socket.recv()
        n_bytes += len(message) + (2 if len(message) < 126 else 4)
    return n_bytes


if __name__ == "__main__":
    counts = asyncio.run(run(sys.argv[1], sys.argv[2], int(sys.argv[3])))
    sys.stdout.write(json.dumps({"bytes_s": counts}) + "\n")
