"""The faces of other computers: a YAML of their addresses, and one request to all of them at once.

The request goes to each face's dashboard, which admits it by its token (`admission.py`). A token
leaves this computer inside TLS alone. Every face has a thread of its own, so that none that is dead
or hangs delays another; what has not answered in time is named and left.
"""

import http.client
import json
import socket
import ssl
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import lru_cache
from http import HTTPStatus
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Annotated, Any, Final
from urllib.parse import SplitResult, urlsplit

from lipservo_client.local_token import is_loopback
from pydantic import Field, ValidationError, field_validator

from firmware_bridge.bus_settings import Strict, Text
from firmware_bridge.process.control_client import printable
from lipservo.access.token_file import read_token
from lipservo.settings.strict_yaml import SettingsError, explain, read_mapping
from lipsync.errors import UserError, shown

#: A computer in the same building answers in milliseconds; one that is switched off, never.
_CONNECTING_S: Final = 2.0
#: Faces that have not answered by then are named while they are still waited for.
_SOON_S: Final = 3.0
_LATE_S: Final = 0.5
#: Longer than the status of 252 servos.
_MOST_BYTES: Final = 1 << 20
#: YAML's own mark of a document's end (https://yaml.org/spec/1.2.2/#914-explicit-documents).
_END: Final = "..."
_PORTS: Final = {"http": 80, "https": 443}

Answer = dict[str, Any]


class KioskError(UserError):
    """Why a face of another computer did not answer; one line without its name."""


class Kiosk(Strict):
    """One face: the URL of its dashboard, and the files of its token and of its certificate.

    certificate: in PEM, of its server or of who signed it; None: as the system trusts.
    """

    url: Text
    token_file: Text
    certificate: Text | None = None

    @field_validator("url")
    @classmethod
    def _is_safe(cls, url: str) -> str:
        """Return the URL without a trailing slash; ValueError if a token must not be sent to it.

        Valid are https:// and, on this computer alone, http://, without user name, query or
        fragment.
        """
        try:
            split = urlsplit(url)
            port = split.port
        except ValueError:
            raise ValueError(f"{shown(url)} is not a URL; write https://HOST:PORT") from None
        odd = split.username is not None or split.query or split.fragment or port == 0
        if split.scheme not in _PORTS or not split.hostname or odd:
            raise ValueError(f"{shown(url)}: write https://HOST:PORT")
        if split.scheme == "http" and not is_loopback(split.hostname):
            raise ValueError(
                f"{shown(url)}: the token would cross the network unencrypted; give the face a TLS "
                "proxy and write https://"
            )
        return url.rstrip("/")


class _Kiosks(Strict):
    kiosks: Annotated[dict[Text, Kiosk], Field(min_length=1)]

    @field_validator("kiosks")
    @classmethod
    def _are_different(cls, kiosks: dict[str, Kiosk]) -> dict[str, Kiosk]:
        """Return the faces by name; ValueError if two have the same URL."""
        names: dict[str, str] = {}
        for name, kiosk in kiosks.items():
            other = names.setdefault(kiosk.url, name)
            if other != name:
                raise ValueError(f"kiosks {other} and {name} have the same url; remove one")
        return kiosks


def read_kiosks(path: Path) -> dict[str, Kiosk]:
    """Return the faces that a YAML lists, by name; paths of their files are relative to the YAML.

    The file must end with the line `...`: a list that was copied only in part would name some of
    the faces, and the others would not be stopped. Raises SettingsError, a line for each error.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise SettingsError(f"{path}: cannot be read: {error}") from error
    content = read_mapping(text, path.name)
    if text.rstrip().rpartition("\n")[2] != _END:
        raise SettingsError(
            f"{path}: its last line must be `{_END}`, so the list may be cut off; copy the whole "
            "list, or add that line"
        )
    try:
        found = _Kiosks.model_validate(content).kiosks
    except ValidationError as error:
        raise SettingsError("\n".join(explain(error, _Kiosks, path.name))) from error
    return {name: _with_full_paths(path.parent, kiosk) for name, kiosk in found.items()}


def _with_full_paths(folder: Path, kiosk: Kiosk) -> Kiosk:
    """Return the face with the paths of its files, which are relative to `folder`, completed."""
    certificate = None if kiosk.certificate is None else str(folder / kiosk.certificate)
    files = {"token_file": str(folder / kiosk.token_file), "certificate": certificate}
    return kiosk.model_copy(update=files)


@dataclass(frozen=True, slots=True)
class KioskRequest:
    """A request to faces: its method and path, the JSON of its body, the seconds that it may take.

    body: None: none.
    """

    method: str
    path: str
    patience_s: float
    body: Mapping[str, object] | None = None


def ask_kiosks(
    kiosks: Mapping[str, Kiosk],
    request: KioskRequest,
    tell_waiting: Callable[[Sequence[str]], None] = lambda _names: None,
) -> Iterator[tuple[str, Answer | KioskError, float]]:
    """Send a request to all faces at once; yield (name, answer, seconds) as each answers.

    The seconds count from the call. A KioskError in place of an answer has the reason why there is
    none. Faces that hang come last, when the request's `patience_s` is over. tell_waiting: called
    once, with the names of the faces that have not answered after 3 s.
    """
    began_s = time.monotonic()
    answered: SimpleQueue[tuple[str, Answer | KioskError]] = SimpleQueue()

    def ask(name: str, kiosk: Kiosk) -> None:
        try:
            answered.put((name, _ask_kiosk(kiosk, request)))
        except KioskError as error:
            answered.put((name, error))

    for name, kiosk in kiosks.items():
        # A look-up of a host name cannot be cancelled: such a thread ends with the program.
        threading.Thread(target=ask, args=(name, kiosk), name=f"kiosk {name}", daemon=True).start()
    waiting = list(kiosks)
    give_up_s = began_s + _CONNECTING_S + request.patience_s + _LATE_S
    tell_s = began_s + _SOON_S
    # Wake for an answer, at 3 s to name the faces that are waited for, and to give up.
    while waiting:
        now_s = time.monotonic()
        if now_s >= tell_s:
            tell_waiting(waiting)
            tell_s = give_up_s
        try:
            name, answer = answered.get(timeout=max(0.0, min(tell_s, give_up_s) - now_s))
        except Empty:
            if time.monotonic() < give_up_s:
                continue
            break
        waiting.remove(name)
        yield name, answer, time.monotonic() - began_s
    for name in waiting:
        yield name, _hang_error(request), time.monotonic() - began_s


def _hang_error(request: KioskRequest) -> KioskError:
    return KioskError(f"hangs: no answer within {request.patience_s:g} s")


def _ask_kiosk(kiosk: Kiosk, request: KioskRequest) -> Answer:
    """Send a request to one face and return its answer. Raises KioskError."""
    split = urlsplit(kiosk.url)
    try:
        token = read_token(kiosk.token_file)
        context = None if split.scheme == "http" else _tls_context(kiosk.certificate)
    except UserError as error:
        raise KioskError(str(error)) from error
    headers = {"Authorization": f"Bearer {token}", "Content-Type": "application/json"}
    body = None if request.body is None else json.dumps(request.body)
    try:
        with closing(_open_connection(split, context, request.patience_s)) as connection:
            connection.request(request.method, split.path + request.path, body, headers)
            response = connection.getresponse()
            content = response.read(_MOST_BYTES + 1)
    except KioskError:
        raise
    except TimeoutError:
        raise _hang_error(request) from None
    except (OSError, ValueError, http.client.HTTPException) as error:
        why = " ".join(str(error).split()) or type(error).__name__
        raise KioskError(f"its server broke off its answer ({why})") from error
    try:
        answer = printable(json.loads(content))
    except (ValueError, RecursionError):
        answer = None
    if response.status == HTTPStatus.UNAUTHORIZED:
        raise KioskError(f"its server refuses the token in {kiosk.token_file}; copy the face's")
    if not isinstance(answer, dict) or response.status != HTTPStatus.OK:
        reason = answer.get("error") if isinstance(answer, dict) else None
        raise KioskError(
            f"its server answers: {reason or f'HTTP {response.status}, nothing that a face says'}"
        )
    return answer


def _open_connection(
    split: SplitResult, context: ssl.SSLContext | None, patience_s: float
) -> http.client.HTTPConnection:
    """Return a connection to a URL's server, inside TLS unless `context` is None.

    patience_s: longest wait for each read. Raises KioskError; OSError if the connection breaks.
    """
    host, port = str(split.hostname), split.port or _PORTS[split.scheme]
    try:
        tcp_socket = socket.create_connection((host, port), _CONNECTING_S)
    except (OSError, UnicodeError) as error:
        why = "no answer" if isinstance(error, TimeoutError) else error
        why = getattr(error, "strerror", None) or why
        raise KioskError(f"no server answers at {host}:{port} ({why})") from error
    tcp_socket.settimeout(patience_s)
    connection = http.client.HTTPConnection(host, port)
    try:
        connection.sock = (
            tcp_socket if context is None else context.wrap_socket(tcp_socket, server_hostname=host)
        )
    except ssl.SSLCertVerificationError as error:
        tcp_socket.close()
        raise KioskError(
            f"its server's certificate is not trusted ({error.verify_message}), so nothing was "
            "sent; give that certificate as `certificate:`"
        ) from error
    except ssl.SSLError as error:
        tcp_socket.close()
        raise KioskError(f"no TLS server is at {host}:{port} ({error.reason})") from error
    except OSError:
        tcp_socket.close()
        raise
    return connection


@lru_cache
def _tls_context(certificate: str | None) -> ssl.SSLContext:
    """Return the TLS settings that trust `certificate`, a PEM file; None: those of the system.

    One object for all faces with the same file. Raises KioskError.
    """
    try:
        return ssl.create_default_context(cafile=certificate)
    except (OSError, ssl.SSLError) as error:
        why = getattr(error, "strerror", None) or error
        raise KioskError(f"{certificate}: cannot be read as PEM certificates: {why}") from error
