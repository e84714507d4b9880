"""The bytes of a control table, and the registers that lie in them, directly or indirectly."""

import struct

from firmware_bridge.dynamixel.control_table import IndirectBlock, Register, ServoModel
from firmware_bridge.dynamixel.wire.codec import StatusError


class RegisterMemory:
    """Register values by name, and reads and writes by address as a servo takes them."""

    def __init__(self, model: ServoModel) -> None:
        self.bytes = bytearray(model.table_size)
        self._indirect = model.indirect
        self._registers = model.registers
        self._by_address = {r.address: r for r in model.registers.values()}

    def __getitem__(self, name: str) -> int:
        register = self._registers[name]
        return register.decode(bytes(self.bytes[register.address : register.end]))

    def __setitem__(self, name: str, value: int) -> None:
        register = self._registers[name]
        self.bytes[register.address : register.end] = register.encode(value)

    def shown(self, address: int, size: int) -> bytes:
        """What a read gets; the present must be up to date."""
        data = bytes(self.bytes[address : address + size])
        for block in self._indirect:
            if address < block.data + block.count and address + size > block.data:
                data = self._through_indirect(block, address, data)
        return data

    def reset_indirect(self) -> None:
        """Every indirect address shows its own data byte."""
        for block in self._indirect:
            for n in range(block.count):
                struct.pack_into("<H", self.bytes, block.addresses + 2 * n, block.data + n)

    def pieces(
        self, address: int, data: bytes, *, locked: bool
    ) -> list[tuple[Register, int]] | StatusError:
        """Which registers a write touches, with their values, through indirect data if need be.

        Empty for a write of indirect addresses, which `map_indirect` then does. locked: torque is
        on, so those cannot be changed.
        """
        for block in self._indirect:
            if block.data <= address < block.data + block.count:
                return self._indirect_pieces(block, address, data)
            if block.addresses <= address < block.addresses + 2 * block.count:
                return StatusError.ACCESS if locked else self._mapping_refusal(block, address, data)
        pieces = []
        end = address + len(data)
        at = address
        while at < end:
            register = self._by_address.get(at)
            if register is None or not register.writable:
                return StatusError.ACCESS
            if register.end > end:
                return StatusError.DATA_LENGTH
            pieces.append((register, register.decode(data[at - address : register.end - address])))
            at = register.end
        return pieces

    def _indirect_pieces(
        self, block: IndirectBlock, address: int, data: bytes
    ) -> list[tuple[Register, int]] | StatusError:
        """The registers behind indirect data, byte by byte."""
        shown: dict[int, int] = {}
        for offset, byte in enumerate(data):
            number = address + offset - block.data
            if number >= block.count:
                return StatusError.ACCESS
            at = block.addresses + 2 * number
            shown[self.bytes[at] | self.bytes[at + 1] << 8] = byte
        pieces = []
        for entry in self._registers.values():
            behind = [n for n in range(entry.address, entry.end) if n in shown]
            if not behind:
                continue
            if not entry.writable:
                return StatusError.ACCESS
            if len(behind) < entry.size:
                return StatusError.DATA_LENGTH
            pieces.append((entry, entry.decode(bytes(shown[n] for n in behind))))
        return pieces

    def map_indirect(self, address: int, data: bytes) -> None:
        """Let indirect data show other addresses; `pieces` has found nothing against it."""
        self.bytes[address : address + len(data)] = data

    def _mapping_refusal(
        self, block: IndirectBlock, address: int, data: bytes
    ) -> list[tuple[Register, int]] | StatusError:
        if (address - block.addresses) % 2 or len(data) % 2:
            return StatusError.DATA_LENGTH
        targets = struct.unpack(f"<{len(data) // 2}H", data)
        if address + len(data) > block.addresses + 2 * block.count:
            return StatusError.ACCESS
        if not all(64 <= target < len(self.bytes) for target in targets):
            return StatusError.DATA_RANGE
        return []

    def _through_indirect(self, block: IndirectBlock, address: int, data: bytes) -> bytes:
        shown = bytearray(data)
        for offset in range(len(data)):
            number = address + offset - block.data
            if 0 <= number < block.count:
                at = block.addresses + 2 * number
                shown[offset] = self.bytes[self.bytes[at] | self.bytes[at + 1] << 8]
        return bytes(shown)
