"""The user's request to run a face: which face, with which sound, motion and outputs.

Made once, from a command's options. The processes of a supervised face receive it whole, as one
argument of JSON, so that no option gets lost.
"""

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

from pydantic import TypeAdapter, ValidationError, with_config

from lipservo.runtime.motion_options import MotionOptions
from lipservo.settings.sections import HIGHEST_RATE_HZ, LOWEST_RATE_HZ
from lipsync.errors import UserError, shown

#: The microphone that the system prefers.
DEFAULT_MICROPHONE = "default"


class RequestError(UserError):
    """A request that contradicts itself, or is not valid JSON; the message is one line."""


@with_config(extra="forbid")
@dataclass(frozen=True, slots=True)
class Sound:
    """The sound that a face listens to or speaks, as the user named it.

    name: a file's path, a microphone by number or name, or the text to say. language, voice,
    rate_wpm, pitch: of that text; "" and None: as in the face's YAML.
    phonemes: a file with the phonemes of the sound file and their times; tier, alphabet: of that
    file, "": as it says. text: the English words of the sound file, to be aligned with it. With
    neither phonemes nor text the sound is recognised. channel: of a file or microphone, "": the
    face's. Raises RequestError.
    """

    kind: Literal["clip", "file", "microphone", "silence", "text"]
    name: str = ""
    language: str = ""
    phonemes: str = ""
    tier: str = ""
    alphabet: str = ""
    text: str = ""
    channel: str = ""
    voice: str | None = None
    rate_wpm: int | None = None
    pitch: int | None = None

    def __post_init__(self) -> None:
        """Raise RequestError for fields that exclude each other, or lack one that they need."""
        if self.phonemes and self.kind != "file":
            raise RequestError("--phonemes needs --wav")
        if (self.tier or self.alphabet) and not self.phonemes:
            raise RequestError("--tier and --alphabet need a file of labels")
        if self.text and (self.kind != "file" or self.phonemes):
            raise RequestError("--text needs a sound file, and no --phonemes")
        if self.channel and self.kind not in ("file", "microphone"):
            raise RequestError("--channel needs a sound file or a microphone")
        if self.language and self.kind != "text":
            raise RequestError("--language needs a text")


#: The bundled clip.
CLIP = Sound("clip")
#: Nothing, without end.
SILENCE = Sound("silence")


#: Where a daemon waits for voice agents.
DEFAULT_LISTEN = "127.0.0.1:8765"
#: The loudspeaker that the system prefers.
DEFAULT_OUTPUT = "default"
#: A loudspeaker that is none: a clock plays into nothing.
SILENT_OUTPUT = "silent"


@with_config(extra="forbid")
@dataclass(frozen=True, slots=True)
class VoiceOptions:
    """The options of a robot that speaks by itself, and of the voice agents that it serves.

    output: its loudspeaker, by number, name or part of a name, or `silent`; None: no sound is
    played here.
    token_file: the file whose first line clients must send; None: clients on this computer need no
    token. sounds: the folder below which agents may have sound files played. queue: speech that
    arrives while another agent speaks waits; otherwise it is refused. origins: of web pages that
    may connect, as the face's YAML lists them, separated by commas.
    """

    output: str | None = None
    token_file: str | None = None
    sounds: str | None = None
    queue: bool = False
    origins: str = ""


#: Where programs that draw an avatar take what others add to it (in the VMC protocol a performer
#: hears an assistant); at 39539 they would have to share the port with whoever draws for them.
_VMC_PORT: Final = 39540
#: Unreal Engine's.
_LIVE_LINK_PORT: Final = 11111
_HIGHEST_PORT: Final = 65_535


class AvatarError(UserError):
    """An avatar's address from the user that cannot be sent to; the message is one line."""


@dataclass(frozen=True, slots=True)
class Address:
    """The host and port of an avatar's program. option: as typed, `--osc HOST`."""

    option: str
    host: str
    port: int


#: Behind the address of an avatar that has vowels and none of ARKit's shapes.
VOWELS: Final = "/vowels"


@with_config(extra="forbid")
@dataclass(frozen=True, slots=True)
class AvatarTargets:
    """The targets of avatar frames (VMC over OSC, Live Link Face), each HOST, HOST:PORT or None.

    With the suffix `/vowels` OSC carries the shapes A I U E O in place of ARKit's.

    No frame is sent anywhere by default: another computer has to be named by the user. Raises
    AvatarError for a malformed address; host names are not resolved here.
    """

    osc: str | None = None
    live_link: str | None = None

    def __post_init__(self) -> None:
        self.addresses()

    def addresses(self) -> tuple[Address | None, Address | None]:
        """Return the parsed addresses for (OSC, Live Link Face), None where no target is given.

        An address without a port gets the protocol's default port. Raises AvatarError.
        """
        return (
            _address("--osc", self.osc and self.osc.removesuffix(VOWELS), _VMC_PORT),
            _address("--live-link", self.live_link, _LIVE_LINK_PORT),
        )

    @property
    def has_vowels(self) -> bool:
        """Whether OSC carries vowels instead of the mouth's ARKit shapes."""
        return self.osc is not None and self.osc.endswith(VOWELS)

    @property
    def is_any(self) -> bool:
        """Whether there is any target at all."""
        return self.osc is not None or self.live_link is not None


def _address(option: str, target: str | None, default_port: int) -> Address | None:
    """Parse a target, HOST or HOST:PORT; None for None. The host is not resolved.

    option: as typed, for the message of AvatarError, which is raised for a malformed target.
    """
    if target is None:
        return None
    typed = f"{option} {shown(target)}"
    host, colon, port = target.partition(":")
    if not host or not host.isprintable() or " " in host:
        raise AvatarError(f"{typed}: write HOST:PORT, such as 127.0.0.1:{default_port}")
    if not colon:
        return Address(typed, host, default_port)
    if not port.isascii() or not port.isdigit():
        raise AvatarError(f"{typed}: write HOST:PORT, such as {host}:{default_port}")
    if len(port) > len(str(_HIGHEST_PORT)) or not 0 < int(port) <= _HIGHEST_PORT:
        raise AvatarError(f"{typed}: the port must be 1 to {_HIGHEST_PORT}")
    return Address(typed, host, int(port))


@with_config(extra="forbid")
@dataclass(frozen=True, slots=True)
class RunRequest:
    """Everything that the user requested for one run of one face.

    config: the face, by the name of a shipped one or the path of its YAML. model: the face model's
    file; None: the shipped one. port: of the servos; None: as the face's YAML has it. rate_hz:
    ticks a second; None: as the face's YAML has it. trace: file to which every tick is written.
    control: path of the control socket; None: in the runtime folder. as_json: results are printed
    as JSON. quiet: no messages for people are printed. dry_run: servos are read and never moved.
    voice: for a robot that speaks; None: it only listens. avatars: on screens, get its frames.
    servos: `RequestedFace.servos` when a supervised face began; "": it begins now.
    Raises RequestError.
    """

    config: str
    sound: Sound
    motion: MotionOptions = field(default_factory=MotionOptions)
    model: Path | None = None
    port: str | None = None
    rate_hz: float | None = None
    trace: Path | None = None
    control: Path | None = None
    as_json: bool = False
    quiet: bool = False
    dry_run: bool = False
    voice: VoiceOptions | None = None
    avatars: AvatarTargets = field(default_factory=AvatarTargets)
    servos: str = ""

    def __post_init__(self) -> None:
        """Raise RequestError for an impossible `rate_hz`, and speech or text that is not used."""
        if self.rate_hz is not None and not LOWEST_RATE_HZ <= self.rate_hz <= HIGHEST_RATE_HZ:
            raise RequestError(
                f"--rate-hz {self.rate_hz:g} is outside the possible {LOWEST_RATE_HZ:g} to "
                f"{HIGHEST_RATE_HZ:g} ticks per second"
            )
        if self.voice is None and (self.sound.kind == "text" or self.sound.phonemes):
            raise RequestError(f"{self.sound.name}: a text, or a file of phonemes, needs a voice")
        if self.sound.text and self.motion.engine == "energy":
            raise RequestError("recogniser energy follows no text; leave --text out")


def about_run(request: RunRequest) -> dict[str, object]:
    """Return a request's face (`config`) and sound folder (`sounds`), for every status answer."""
    sounds = None if request.voice is None else request.voice.sounds
    return {"config": request.config, "sounds": sounds}


def request_json(request: RunRequest) -> str:
    """Return the request as JSON on one line, which `request_of_json` parses."""
    return json.dumps(asdict(request), default=str)


def request_of_json(text: str) -> RunRequest:
    """Parse a request from JSON on one line.

    Raises RequestError for invalid JSON, and for a missing, unknown or mistyped field.
    """
    try:
        value = json.loads(text)
        request = TypeAdapter(RunRequest).validate_python(value)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(["request", *map(str, first["loc"])])
        # An error that our own checks of the fields have raised is shown as it is.
        ours = first.get("ctx", {}).get("error")
        why = (
            ours if isinstance(ours, UserError) else f"{first['msg']}, not {shown(first['input'])}"
        )
        raise RequestError(f"{where}: {why}") from error
    except (ValueError, RecursionError) as error:
        raise RequestError(f"request: not JSON: {error}") from error
    _check_unchanged(value, json.loads(request_json(request)), "request")
    return request


_KINDS: Final = {str: "text", bool: "true or false", float: "a number"}


def _check_unchanged(given: Any, read: Any, where: str) -> None:
    """Raise RequestError if `given` lacks a field of `read`, or has a value of another type.

    given: parsed JSON. read: the request made from it, as JSON again. A whole number where a float
    is expected is allowed. where: path of the value, for the message.
    """
    if isinstance(read, dict):
        for name, value in read.items():
            if name not in given:
                raise RequestError(f"{where}.{name}: is missing")
            _check_unchanged(given[name], value, f"{where}.{name}")
    elif type(given) is not type(read) and (type(given), type(read)) != (int, float):
        raise RequestError(f"{where}: {shown(given)} is not {_KINDS[type(read)]}")
