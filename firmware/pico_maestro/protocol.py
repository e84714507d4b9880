"""The part of the Pololu Maestro's protocol that firmware_bridge/maestro speaks, for MicroPython.

Bytes and milliseconds go in, answers and pulses come out; nothing of a board is imported. Pulses,
targets and positions are counted in quarters of a microsecond, 0: no pulse. Memory does not grow.
"""

SET_TARGET, SET_TARGETS, SET_SPEED, SET_ACCELERATION = 0x84, 0x9F, 0x87, 0x89
GET_POSITION, GET_MOVING_STATE, GET_ERRORS = 0x90, 0x93, 0xA1
GO_HOME, POLOLU = 0xA2, 0xAA
# Data bytes of each command but SET_TARGETS, which has 2 + 2 n, n the first of them.
N_DATA = {SET_TARGET: 3, SET_SPEED: 3, SET_ACCELERATION: 3, GET_POSITION: 1}
# Head of the Pololu form, and SET_TARGETS with as many targets as its count can say.
LONGEST = 3 + 2 + 2 * 127
PROTOCOL_ERROR = 1 << 4
TIMEOUT_ERROR = 1 << 5


class Maestro:
    """Any error stops all pulses, as a Maestro does whose channels are Off on startup or error."""

    def __init__(self, n_channels, shortest_us, longest_us, timeout_ms, device=12):
        """timeout_ms: longest time without a complete command. device: its Pololu number."""
        self._shortest, self._longest = 4 * shortest_us, 4 * longest_us
        self._timeout_ms, self._device = timeout_ms, device
        self._targets = [0] * n_channels
        self._speeds = [0] * n_channels
        # In tenths: a speed is so many quarters in 10 ms.
        self._tenths = [0] * n_channels
        self._silent_ms = 0
        self._message = bytearray(LONGEST)
        self._n_bytes = 0
        self.errors = 0

    def pulse(self, channel):
        """What a channel sends now."""
        return (self._tenths[channel] + 5) // 10

    def advance(self, elapsed_ms):
        """Let time pass: bounded speeds move on; pulses stop once no command came for too long."""
        for channel, target in enumerate(self._targets):
            left = 10 * target - self._tenths[channel]
            if left:
                speed = self._speeds[channel]
                reach = speed * elapsed_ms if speed else abs(left)
                self._tenths[channel] += max(-reach, min(reach, left))
        self._silent_ms = min(self._silent_ms + elapsed_ms, self._timeout_ms + 1)
        if self._silent_ms > self._timeout_ms:
            self._fail(TIMEOUT_ERROR)

    def receive(self, byte):
        """Take one byte; the answer, mostly none."""
        if byte & 0x80:
            if self._n_bytes:
                self._fail(PROTOCOL_ERROR)
            self._n_bytes = 0
        elif not self._n_bytes:
            self._fail(PROTOCOL_ERROR)
            return b""
        self._message[self._n_bytes] = byte
        self._n_bytes += 1
        message, n_head = self._message, 3 if self._message[0] == POLOLU else 1
        if self._n_bytes < n_head:
            return b""
        code = message[n_head - 1] | 0x80
        if code != SET_TARGETS:
            n_data = N_DATA.get(code, 0)
        else:
            n_data = 2 + (2 * message[n_head] if self._n_bytes > n_head else 0)
        if self._n_bytes < n_head + n_data:
            return b""
        self._n_bytes = 0
        if n_head == 3 and message[1] != self._device:
            return b""
        self._silent_ms = 0
        return self._obey(code, n_head)

    def _obey(self, code, at):
        """at: of the first data byte. Bytes behind the message are left over from others."""
        message, n_channels = self._message, len(self._targets)
        channel, value = message[at], message[at + 1] | message[at + 2] << 7
        if code == GET_ERRORS:
            errors, self.errors = self.errors, 0
            return bytes((errors, 0))
        if code == GET_MOVING_STATE:
            return bytes(
                (any(self._tenths[n] != 10 * self._targets[n] for n in range(n_channels)),)
            )
        if code == GO_HOME:
            self._go_home()
        elif code == SET_TARGETS and channel and channel + message[at + 1] <= n_channels:
            for n in range(channel):
                low = at + 2 + 2 * n
                self._set_target(message[at + 1] + n, message[low] | message[low + 1] << 7)
        elif code == SET_TARGET and channel < n_channels:
            self._set_target(channel, value)
        elif code == SET_SPEED and channel < n_channels:
            self._speeds[channel] = value
        elif code == GET_POSITION and channel < n_channels:
            return bytes((self.pulse(channel) & 0xFF, self.pulse(channel) >> 8))
        # Only "no bound" can be kept of accelerations: any other is an error, not a promise.
        elif code != SET_ACCELERATION or channel >= n_channels or value:
            self._fail(PROTOCOL_ERROR)
        return b""

    def _set_target(self, channel, target):
        if target:
            target = max(self._shortest, min(self._longest, target))
        self._targets[channel] = target
        # Where it is unknown or unbounded, or is to be off, it is there at once.
        if not (target and self._tenths[channel] and self._speeds[channel]):
            self._tenths[channel] = 10 * target

    def _fail(self, error):
        self.errors |= error
        self._go_home()

    def _go_home(self):
        for channel in range(len(self._targets)):
            self._targets[channel] = self._tenths[channel] = 0
