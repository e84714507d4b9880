"""To whom the face is sent besides: screen avatars, each by an address that the user named."""

from dataclasses import dataclass
from typing import Final

from lipsync.errors import UserError, shown
from lipsync.export.live_link import LIVE_LINK_PORT
from lipsync.export.osc import VMC_PORT

_HIGHEST_PORT: Final = 65_535


class AvatarError(UserError):
    """Nobody can be sent to where the user says; one line."""


@dataclass(frozen=True, slots=True)
class Address:
    """Where to send datagrams. option: where the user named it, as text: `--osc HOST`."""

    option: str
    host: str
    port: int


@dataclass(frozen=True, slots=True)
class AvatarTargets:
    """Who is sent to, each as HOST or HOST:PORT, or None: OSC of the VMC protocol, Live Link Face.

    Nothing is sent anywhere by default: another computer has to be named by the user. Raises
    AvatarError for what is no address; whether there is such a host, nobody asks here.
    """

    osc: str | None = None
    live_link: str | None = None

    def __post_init__(self) -> None:
        self.addresses()

    def addresses(self) -> tuple[Address | None, Address | None]:
        """Of OSC and of Live Link Face; without a port that which receivers begin with."""
        return (
            _address("--osc", self.osc, VMC_PORT),
            _address("--live-link", self.live_link, LIVE_LINK_PORT),
        )

    @property
    def is_any(self) -> bool:
        """Whether anybody is sent to."""
        return self.osc is not None or self.live_link is not None


def _address(option: str, target: str | None, default_port: int) -> Address | None:
    if target is None:
        return None
    typed = f"{option} {shown(target)}"
    host, colon, port = target.partition(":")
    if not host or not host.isprintable() or " " in host:
        raise AvatarError(f"{typed}: give HOST:PORT, 127.0.0.1:{default_port} for one")
    if not colon:
        return Address(typed, host, default_port)
    if not port.isascii() or not port.isdigit():
        raise AvatarError(f"{typed}: give HOST:PORT, {host}:{default_port} for one")
    if len(port) > len(str(_HIGHEST_PORT)) or not 0 < int(port) <= _HIGHEST_PORT:
        raise AvatarError(f"{typed}: a port is a number from 1 to {_HIGHEST_PORT}")
    return Address(typed, host, int(port))
