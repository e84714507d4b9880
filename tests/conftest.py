import asyncio
import logging
import os
import signal
from inspect import iscoroutinefunction, signature
from pathlib import Path

import pytest
from hypothesis import settings
from places import short_folder

from firmware_bridge.process.log_lines import LogLines, LogWriter

# Before NumPy is loaded, here and in whatever the tests start: threads of BLAS that share a small
# product wait for each other while other tests run, for a hundred times its time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Machines are shared: how long an example takes says nothing about the code.
settings.register_profile("lipservo", deadline=None)
settings.load_profile("lipservo")

# Faces of tests that run side by side, and those of whoever sits at this computer, do not meet.
os.environ["XDG_RUNTIME_DIR"] = str(short_folder())
os.environ["LIPSERVO_STATE"] = str(short_folder())
for variable in ("RUNTIME_DIRECTORY", "LIPSERVO_RUNTIME"):
    os.environ.pop(variable, None)

# Started behind `nohup` or with `&`, this process and all that it starts would not hear them.
signal.signal(signal.SIGINT, signal.default_int_handler)
for number in (signal.SIGHUP, signal.SIGQUIT):
    signal.signal(number, signal.SIG_DFL)


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem):
    """A test that is a coroutine has a loop of its own."""
    test = pyfuncitem.obj
    if not iscoroutinefunction(test):
        return None
    asyncio.run(test(**{name: pyfuncitem.funcargs[name] for name in signature(test).parameters}))
    return True


@pytest.fixture(autouse=True)
def _no_settings_of_logging():
    """A command that runs in this process sets them for its own."""
    yield
    root = logging.getLogger()
    for handler in [each for each in root.handlers if isinstance(each, (LogLines, LogWriter))]:
        root.removeHandler(handler)
    for name in ("calibration", "firmware_bridge", "lipservo", "lipservo_lab", "lipsync"):
        logging.getLogger(name).setLevel(logging.NOTSET)


@pytest.fixture(scope="session")
def corpus_dir() -> Path:
    """The corpora, which lie beside the checkout and are not part of it."""
    folder = Path(__file__).parents[2] / "shared" / "corpus"
    if not folder.is_dir():
        pytest.skip(f"the corpora are not at {folder}")
    return folder
