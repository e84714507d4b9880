"""Which channel of a sound is heard, as a person names it: `left`, `right`, `mix` or a number."""

from typing import Final

#: The average of all channels.
MIX: Final = "mix"
_NAMED: Final = {MIX: 1, "left": 1, "right": 2}
#: More than any recorder writes; a header that says more is damaged.
MOST_CHANNELS: Final = 32


def checked_channel(text: str) -> str:
    """Return `text` if it names a channel. Raises ValueError."""
    text = text.strip().lower()
    number = int(text) if text.isdecimal() and len(text) < 4 else _NAMED.get(text, 0)
    if not 1 <= number <= MOST_CHANNELS:
        raise ValueError(f"{text[:40]!r}: channels are left, right, mix, or 1 to {MOST_CHANNELS}")
    return text


def channel_or_mix(channel: str, n_channels: int) -> str:
    """Return a channel that `checked_channel` allows; `mix` for a sound with too few channels."""
    return channel if (_NAMED.get(channel) or int(channel)) <= n_channels else MIX


def channel_index(channel: str, n_channels: int, where: str) -> int | None:
    """Return the index from 0 of a channel that `checked_channel` allows; None: all are mixed.

    where: file or device, for messages. Raises SoundError where there are fewer channels.
    """
    if channel in ("", MIX):
        return None
    number = _NAMED.get(channel) or int(channel)
    if number > n_channels:
        # Imported here, so that reading settings does not load numpy.
        from lipsync.audio.source import SoundError

        count = "1 channel" if n_channels == 1 else f"{n_channels} channels"
        raise SoundError(f"{where}: has {count}, not {channel}; leave --channel out, or give mix")
    return number - 1
