"""Switch off the servo pulses of a Pololu Maestro that another process drove before."""

import math
from collections.abc import Sequence
from typing import Final

from firmware_bridge.errors import PortError
from firmware_bridge.maestro.controller import Maestro
from firmware_bridge.maestro.protocol import N_CHANNELS, SET_TARGET
from firmware_bridge.maestro.settings import MaestroSettings
from firmware_bridge.transport import Transport

_REPEATS: Final = 3


class MaestroRelease:
    """A `PortRelease` that switches a Maestro's pulses off; no servo confirms that it is limp."""

    confirms: Final = False

    def __init__(
        self, transport: Transport, port: str, settings: MaestroSettings, *, knows: bool
    ) -> None:
        """Prepare to switch pulses off over `transport`, an open port named `port` in messages.

        knows: whether `settings` are from the YAML of a face, so that the number of channels is
        certain; else it counts as that of the smallest model until `find` has tried more.
        """
        self._maestro = Maestro(transport, settings)
        self._port, self._knows = port, knows
        self._n_channels = settings.n_channels if knows else min(N_CHANNELS.values())

    def tell_all(self, addresses: Sequence[int]) -> None:
        """Switch off all channels' pulses, and read back that the channels `addresses` send none.

        If `addresses` is empty, channel 0 is read. A Maestro may ignore a command: pulses off is
        repeated up to three times. Raises PortError when channels still send afterwards, or no
        Maestro answers.
        """
        # left: channels that have not been read as off; NaN (no answer) counts as on.
        channels: Sequence[int] = range(self._n_channels)
        left: Sequence[int] = addresses or (0,)
        for _ in range(1 + _REPEATS):
            self._maestro.tell(*[(SET_TARGET, (each, 0, 0)) for each in channels])
            channels = left = [each for each in left if self._maestro.position_us(each) != 0.0]
            if not left:
                return
            self._maestro.check(self._port)
        raise PortError(
            f"{self._port}: the Maestro still drives channels {left}; switch the servos' power off"
        )

    def ask(self, address: int) -> str:
        """Return why the servo of channel `address` never counts as limp: it reports nothing."""
        return f"channel {address} cannot say whether its servo holds"

    def find(self, addresses: Sequence[int]) -> Sequence[int]:
        """Switch all pulses off, and return the channels to report on.

        These are `addresses`, or all channels of the Maestro if `addresses` is empty or the model
        is unknown. The number of channels of an unknown model is found by reading the last channel
        of ever larger models. A read of a missing channel is an error, at which a Maestro may send
        servos to their home positions: so pulses are switched off again afterwards.
        """
        self.tell_all(addresses)
        if self._knows:
            return addresses or range(self._n_channels)
        for n_channels in sorted(set(N_CHANNELS.values()))[1:]:
            if math.isnan(self._maestro.position_us(n_channels - 1)):
                break
            self._n_channels = n_channels
        self.tell_all(range(self._n_channels))
        return range(self._n_channels)

    def close(self) -> None:
        """Close the port."""
        self._maestro.transport.close()
