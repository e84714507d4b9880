"""A socket that lies where faces are looked for and is none: `python foreign_socket.py KIND`.

The folder comes in the environment and not in the command line, for a process whose command line
names our program counts as ours. silent: accepts and never answers. endless: answers every word as
if the stop was accepted, and never ends.
"""

import json
import os
import select
import socket
import sys
from pathlib import Path
from typing import Final

FOLDER_VARIABLE: Final = "FOREIGN_FOLDER"
#: Before every face of ours in the order of names.
_NAME: Final = "a_stranger"


def main(kind: str) -> None:
    """Listen on a socket in the folder of faces until killed. kind: "silent" or "endless"."""
    path = Path(os.environ[FOLDER_VARIABLE]) / f"{_NAME}-{os.getpid()}.sock"
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    listener.bind(str(path))
    listener.listen(16)
    client_of_fd: dict[int, socket.socket] = {}
    answer = json.dumps({"accepted": "limp", "name": "stranger", "port": "/dev/null"}).encode()
    while True:
        ready = select.select([listener, *client_of_fd.values()], [], [], 0.5)[0]
        for ready_socket in ready:
            if ready_socket is listener:
                client, _ = listener.accept()
                client_of_fd[client.fileno()] = client
                continue
            number = ready_socket.fileno()
            try:
                if not ready_socket.recv(4096):
                    raise ConnectionResetError
                if kind == "endless":
                    ready_socket.send(answer, socket.MSG_NOSIGNAL)
            except OSError:
                client_of_fd.pop(number).close()


if __name__ == "__main__":
    main(sys.argv[1])
