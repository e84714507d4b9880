"""Send the frames that the face shows to screen avatars: VMC protocol (OSC) or Live Link Face."""

import logging
import math
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from lipservo.runtime.run_request import VOWELS, Address, AvatarError, AvatarTargets
from lipservo.runtime.status.street_tick import StreetTick
from lipsync.animpho.units import load_face_with_animphos
from lipsync.arrays import Array
from lipsync.export.arkit import ARKIT_NAMES, MOUTH_NAMES, ArkitMap, lip_measures, vowels
from lipsync.export.weight_track import live_link_packet, vmc_packets
from lipsync.face.frame import Frame

_LOG = logging.getLogger(__name__)
#: The name under which Unreal Engine lists the face.
SUBJECT = "lipservo"
#: What avatars are drawn at.
_RATE_HZ = 60.0
#: Sums of the same times differ by less.
_ROUNDING_S = 1e-9
_MOUTH = frozenset(MOUTH_NAMES)


class AvatarStream:
    """An observer of ticks that sends the face's frames to screen avatars, 60 a second at most.

    Frames are sent as UDP datagrams, and no send ever blocks. A receiver that is slow or absent
    loses frames; datagrams that the operating system did not accept are counted in `n_failed`.
    """

    def __init__(
        self,
        arkit: ArkitMap,
        rest: Array,
        osc: socket.socket | None,
        live_link: socket.socket | None,
        *,
        has_vowels: bool = False,
    ) -> None:
        """Create the stream; nothing is sent yet.

        arkit: converts frames into ARKit blendshape weights. rest: (n_components,), face
        coefficients of the closed mouth that is sent at the end. osc, live_link: connected,
        non-blocking UDP sockets; None: nothing is sent in that protocol. has_vowels: OSC carries
        vowels instead of the mouth's ARKit shapes.
        """
        self._arkit = arkit
        self._rest = rest
        self._osc, self._live_link = osc, live_link
        self._has_vowels = has_vowels
        self._due_s = -math.inf
        self._sound_s = 0.0
        self._sent_names: set[str] = set(_MOUTH)
        #: Datagrams that were handed to the system, and those that it did not take.
        self.n_sent = 0
        self.n_failed = 0

    def observe(self, tick: StreetTick) -> None:
        """Send the frame shown in `tick`, unless a frame was sent less than 1/60 s before."""
        self.show(tick.report.time_s, tick.sound_s, tick.frame)

    def show(self, time_s: float, sound_s: float, frame: Frame) -> None:
        """Send `frame`, unless a frame was sent less than 1/60 s before.

        time_s: monotonic time of display, ascending from call to call. sound_s: sound time of the
        frame.
        """
        if time_s < self._due_s - _ROUNDING_S:
            return
        # Due times are on a grid, so that frames a little late do not delay all later ones.
        on_grid = time_s < self._due_s + 1.0 / _RATE_HZ
        self._due_s = (self._due_s if on_grid else time_s) + 1.0 / _RATE_HZ
        self._sound_s = sound_s
        self._send(sound_s, frame)

    def _send(self, sound_s: float, frame: Frame) -> None:
        """Send a frame in each protocol that has a receiver. sound_s: its sound time."""
        values = self._arkit.values(frame)
        if self._osc is not None:
            for packet in vmc_packets(self._shapes(values)):
                self._send_packet(self._osc, packet)
        if self._live_link is not None:
            self._send_packet(self._live_link, live_link_packet(values, SUBJECT, sound_s))

    def end(self) -> None:
        """Send one frame with the closed mouth, which avatars keep showing; call it last."""
        self._send(self._sound_s, Frame(self._sound_s, self._rest))

    def _shapes(self, values: Array) -> list[tuple[str, float]]:
        """Return the (name, value) pairs to send over OSC, from all ARKit weights `values`.

        The mouth's shapes are always sent, any other ARKit shape once its value was ever above 0.
        With `has_vowels`, vowels come first and replace the mouth's shapes.
        """
        pairs = list(zip(ARKIT_NAMES, values.tolist(), strict=True))
        self._sent_names.update(name for name, value in pairs if value > 0.0)
        known_pairs = [pair for pair in pairs if pair[0] in self._sent_names]
        if not self._has_vowels:
            return known_pairs
        return [*vowels(values).items(), *(pair for pair in known_pairs if pair[0] not in _MOUTH)]

    def _send_packet(self, receiver: socket.socket, packet: bytes) -> None:
        """Send a datagram without blocking, and count it as sent or failed."""
        try:
            receiver.send(packet)
            self.n_sent += 1
        except OSError:  # no receiver, no route or no room: the next frame takes its place
            self.n_failed += 1


@contextmanager
def avatar_stream(targets: AvatarTargets, model: Path | None = None) -> Iterator[AvatarStream]:
    """Open the sockets to the targets, yield the stream, and send a closed mouth at the end.

    model: the file of the face model, None for the shipped one. Raises AvatarError for a target
    that cannot be sent to, ModelError and MeasureError.
    """
    face = load_face_with_animphos(model)
    osc_at, live_link_at = targets.addresses()
    with _connected_socket(osc_at) as osc, _connected_socket(live_link_at) as live_link:
        arkit, has_vowels = ArkitMap(lip_measures(face)), targets.has_vowels
        stream = AvatarStream(arkit, face.rest, osc, live_link, has_vowels=has_vowels)
        try:
            yield stream
        finally:
            stream.end()


def entered_avatars(
    targets: AvatarTargets, model: Path | None, stack: ExitStack
) -> AvatarStream | None:
    """Enter an avatar stream on `stack` and return it; None for no target or an unreachable one.

    Unreachable targets are logged, not raised, so that the caller speaks on without avatars. model:
    the face model's file; None: the shipped one. Raises ModelError and MeasureError.
    """
    if not targets.is_any:
        return None
    try:
        return stack.enter_context(avatar_stream(targets, model))
    except AvatarError as error:
        _LOG.warning("avatars get no motion: %s", error)
        return None


def resolved_avatars(targets: AvatarTargets) -> AvatarTargets:
    """Return the targets with host names replaced by IP addresses, so that none is looked up later.

    Raises AvatarError for a target that cannot be sent to.
    """
    found: list[str | None] = []
    for address in targets.addresses():
        with _connected_socket(address) as sender:
            found.append(None if sender is None else "{}:{}".format(*sender.getpeername()))
    # The suffix `/vowels` belongs to the target, not to its address.
    osc, live_link = found
    return AvatarTargets(osc and osc + VOWELS * targets.has_vowels, live_link)


@contextmanager
def _connected_socket(address: Address | None) -> Iterator[socket.socket | None]:
    """Yield a non-blocking UDP socket connected to `address`; None if `address` is None."""
    if address is None:
        yield None
        return
    try:
        found = socket.getaddrinfo(address.host, address.port, socket.AF_INET, socket.SOCK_DGRAM)
    except (OSError, UnicodeError) as error:
        raise AvatarError(f"{address.option}: no such host ({error})") from error
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as connection:
        connection.setblocking(False)
        try:
            connection.connect(found[0][4])
        except OSError as error:
            raise AvatarError(f"{address.option}: cannot be reached: {error.strerror}") from error
        yield connection
