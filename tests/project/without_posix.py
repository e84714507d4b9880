"""`python without_posix.py ARGUMENTS`: lipservo as where Python has nothing of POSIX (Windows).

What the standard library itself needs here is imported before it is hidden.
"""

import asyncio  # noqa: F401
import multiprocessing.connection  # noqa: F401
import os
import shutil  # noqa: F401
import signal
import socket
import subprocess  # noqa: F401
import sys
import tempfile  # noqa: F401
from importlib import import_module

for _name in ("fcntl", "termios", "resource", "pwd", "grp", "pty", "tty", "curses", "syslog"):
    sys.modules[_name] = None
for _module, _names in {
    os: "geteuid getuid getgid fchown chown killpg setsid sched_setscheduler O_CLOEXEC "
    "O_DIRECTORY O_NOFOLLOW O_NONBLOCK O_NOCTTY",
    signal: "SIGHUP SIGQUIT SIGKILL SIGUSR1 SIGUSR2 SIGALRM setitimer pthread_sigmask",
    socket: "AF_UNIX SO_PEERCRED",
}.items():
    for _name in _names.split():
        delattr(_module, _name)


def import_all():
    """Import what each command is in; print those that cannot be."""
    from lipservo import cli

    for command in cli.COMMANDS.values():
        if command.target:
            try:
                import_module(command.target.partition(":")[0])
            except Exception as error:
                print(command.target, repr(error))  # noqa: T201


if sys.argv[1:] == ["import-all"]:
    import_all()
else:
    from lipservo.__main__ import main

    main()
