"""The phoneme inventory, the viseme classes, and what a recogniser reports about phonemes.

The 39 phones of the CMU pronouncing dictionary plus SIL, upper case, without stress.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Literal, Protocol, Self, runtime_checkable

from lipsync.arrays import Array, Array32
from lipsync.audio_block import AudioBlock

SILENCE = "SIL"

#: The scoring classes: phones that look alike on the lips are right or wrong together.
VISEME_CLASSES: tuple[tuple[str, ...], ...] = (
    (SILENCE,),
    ("P", "B", "M"),
    ("F", "V"),
    ("TH", "DH"),
    ("T", "D", "N", "S", "Z", "L"),
    ("SH", "ZH", "CH", "JH"),
    ("K", "G", "NG"),
    ("W",),
    ("R",),
    ("HH",),
    ("IY", "IH", "Y"),
    ("EH", "AE", "EY"),
    ("AA", "AH", "AY", "AW"),
    ("AO", "OW", "OY"),
    ("UW", "UH"),
    ("ER",),
)

PHONEMES: tuple[str, ...] = tuple(sorted(p for viseme in VISEME_CLASSES for p in viseme))

VISEME_OF: Mapping[str, int] = MappingProxyType(
    {phoneme: index for index, viseme in enumerate(VISEME_CLASSES) for phoneme in viseme}
)

# Tried in order; each entry is a sequence of phones that together make the same mouth movement.
# Diphthongs become their two ends; NG and ER look like N and R once the tongue is hidden.
_STAND_INS: Mapping[str, tuple[tuple[str, ...], ...]] = MappingProxyType(
    {
        "NG": (("N",), ("K",)),
        "ER": (("R",), ("AH",)),
        "OY": (("AO", "IY"), ("OW", "IY"), ("AO",)),
        "AY": (("AA", "IY"), ("AH", "IY")),
        "AW": (("AA", "UW"), ("AH", "UW")),
        "EY": (("EH", "IY"), ("EH",)),
        "OW": (("AO", "UW"), ("AO",)),
        "UH": (("UW",), ("OW",), ("W",)),
        "UW": (("UH",), ("W",), ("OW",)),
        "W": (("UW",), ("OW",)),
        "R": (("ER",), ("W",), ("L",)),
        "HH": (("AH",), ("EH",)),
        "Y": (("IY",), ("IH",)),
        "TH": (("DH",), ("T",)),
        "DH": (("TH",), ("D",)),
        "K": (("G",), ("NG",), ("T",)),
        "G": (("K",), ("NG",), ("D",)),
    }
)


def stand_in(phoneme: str, known: Sequence[str] | frozenset[str]) -> tuple[str, ...]:
    """Return phones of `known` that together resemble `phoneme` on the lips.

    known: phones that a model has. Returned is `(phoneme,)` if `phoneme` itself is known, else a
    named substitute (OY as AO then IY), else a phone of the same viseme class, else any known
    phone, so that every phone of the inventory moves the mouth. Raises ValueError for a phoneme
    outside the inventory or an empty `known`.
    """
    if phoneme not in VISEME_OF:
        raise ValueError(f"unknown phoneme {phoneme!r}; use one of {' '.join(PHONEMES)}")
    if not known:
        raise ValueError("the list of phonemes is empty")
    if phoneme in known:
        return (phoneme,)
    for candidate in _STAND_INS.get(phoneme, ()):
        if all(part in known for part in candidate):
            return candidate
    for sibling in VISEME_CLASSES[VISEME_OF[phoneme]]:
        if sibling in known:
            return (sibling,)
    spoken = sorted(p for p in known if p != SILENCE)
    return (("AH" if "AH" in spoken else spoken[0]) if spoken else SILENCE,)


@dataclass(frozen=True, slots=True)
class PhonemeEvent:
    """One phoneme and its time in the sound; `end_s` is None while the phoneme still continues."""

    phoneme: str
    start_s: float
    end_s: float | None
    confidence: float = 1.0

    def later(self, by_s: float) -> Self:
        """Return a copy of this event `by_s` seconds later; an open end stays open."""
        end_s = None if self.end_s is None else self.end_s + by_s
        return replace(self, start_s=self.start_s + by_s, end_s=end_s)


@dataclass(frozen=True, slots=True)
class FramePosteriors:
    """Probabilities of each phoneme, frame by frame, before phonemes are decided.

    values: (n, n_heads, len(PHONEMES)), in the order of PHONEMES; those of a head in a frame sum to
    1. A head (output) of the network waits d = delays[h] frames: its row i belongs to frame number
    `first_frame` + i - d, which begins at that number / frames_per_s. A head that waits longer is
    more reliable.
    """

    frames_per_s: int
    first_frame: int
    delays: tuple[int, ...]
    values: Array32

    def later(self, by_s: float) -> Self:
        """Return a copy of these posteriors `by_s` seconds later, rounded to whole frames."""
        return replace(self, first_frame=self.first_frame + round(by_s * self.frames_per_s))


@dataclass(frozen=True, slots=True)
class PhonemeUpdate:
    """A source's phonemes from `replace_from_s` on, which replace all its earlier ones from there.

    Events are in order of time, do not overlap, and only the last may have no end. The first may
    have begun before `replace_from_s`: it is then the phoneme that continues at that time, with its
    true start. The sound was heard until `heard_until_s`; no phoneme before `final_until_s` changes
    again. posteriors: of the frames heard since the last update, from which the events were
    decided; None where no frame was heard, or the phonemes are known beforehand. evidence: the
    same, also where the phonemes were decided by a text.
    """

    replace_from_s: float
    heard_until_s: float
    final_until_s: float
    events: tuple[PhonemeEvent, ...]
    posteriors: FramePosteriors | None = field(default=None, compare=False, repr=False)
    evidence: FramePosteriors | None = field(default=None, compare=False, repr=False)


class PhonemeScript(Protocol):
    """Phonemes known beforehand (label file, speech synthesis), released as their time comes."""

    def updates(self, until_s: float) -> list[PhonemeUpdate]:
        """Return the updates for the sound before `until_s` that are new since the last call."""


class PhonemeSource(PhonemeScript, Protocol):
    """A source of phonemes for live motion: a recogniser with its sound, or a script."""

    @property
    def latency_s(self) -> float:
        """Seconds until a phoneme is due: at t, those before t - latency_s are told, final soon."""

    @property
    def heard_until_s(self) -> float:
        """The sound time in s up to which sound was heard or phonemes are known."""


#: What is believed about the sound: somebody speaks, something else is to be heard, or nothing is.
Hearing = Literal["speech", "noise", "silence"]


@runtime_checkable
class Listener(Protocol):
    """A recogniser that also classifies its sound as speech, noise or silence."""

    @property
    def hearing(self) -> Hearing | None:
        """The class of the newest final sound: speech, noise, silence; None if not classified."""


@runtime_checkable
class ServoListener(Protocol):
    """A recogniser that discounts the noise of the robot's own servos, given their speeds."""

    def note_servo_speeds(self, sound_s: float, speeds_deg_s: Array) -> None:
        """Store the servos' speeds at a sound time, so that their noise is not recognised as voice.

        Parameters
        ----------
        sound_s : float
            Seconds of sound time.
        speeds_deg_s : Array
            (n_servos,) in deg/s; NaN: not known.
        """


class LiveRecognizer(Protocol):
    """A recogniser of phonemes in live sound; its results depend on the sound fed, on no clock."""

    @property
    def latency_s(self) -> float:
        """Seconds until a phoneme is due: at t, those before t - latency_s are told, final soon."""

    def feed(self, block: AudioBlock) -> None:
        """Process the next block of sound, of any size; a gap before it counts as silence."""

    def updates(self) -> list[PhonemeUpdate]:
        """Return the phoneme updates that are new since the last call."""

    def reset(self) -> None:
        """Forget all sound and phonemes; the next block begins a new stream, from time 0 on."""


@dataclass(frozen=True, slots=True)
class RecognizerKind:
    """A way to make a live recogniser: an entry of `lipsync.plugins.RECOGNIZERS`.

    make: from the name or file of weights, and the latency in seconds after which a phoneme is to
    be final; a recogniser without such weights ignores both. latency_s: the least that it needs.
    """

    make: Callable[[str, float], LiveRecognizer]
    latency_s: float = 0.0
