"""What every face that a test acts has: a control socket, a board to watch, and a thread."""

import threading

from firmware_bridge.process.control_socket import ControlSocket


class AnsweringFace:
    """Answers while it is entered. Give it a name, path, commands, board, and a loop in `_run`."""

    def __init__(self, name, path, commands, board):
        self.name = name
        self.path = path
        self.commands = commands
        self.board = board
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self):
        about = {"name": self.name, "port": None}
        watched_fd = self.board.fileno()
        self._control = ControlSocket(self.path, about, self.commands, watched_fd=watched_fd)
        self._thread.start()
        return self

    def __exit__(self, *exc):
        self._over.set()
        self._thread.join()
        self._control.__exit__(*exc)
        self.board.__exit__(*exc)
