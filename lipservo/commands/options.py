"""The options of commands, each declared once.

Quick commands such as `stop` import this module: it loads nothing that takes long.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from firmware_bridge.errors import BusError
from lipservo.settings.motion_names import (
    DEFAULT_STRATEGY,
    LONGEST_LOOKAHEAD_MS,
    ONLY_UNITS,
    SMOOTHEST,
    STRONGEST,
    MeasuredEngine,
    Strategy,
)
from lipsync.audio.channels import checked_channel
from lipsync.errors import UserError
from lipsync.phoneme_files.label_file import LabelFile
from lipsync.plugins import RECOGNIZERS

DEFAULT_FACE = "face_sim"


def refusing(check: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Return `check` for an option or a prompt, with its errors as BadParameter.

    At that a prompt repeats its question.
    """

    def checked(value: Any) -> Any:
        try:
            return check(value)
        except (UserError, BusError, ValueError) as error:
            raise typer.BadParameter(str(error)) from error

    return checked


# ---- which face ----

Config = Annotated[
    str, typer.Option(help="Face: the name of a shipped face, or the path of a face's YAML file.")
]
Model = Annotated[
    Path | None, typer.Option(help="Face model, a .npz file; default: the shipped model.")
]
Port = Annotated[
    str | None,
    typer.Option(
        help="Serial port of the servos, such as /dev/ttyUSB0; default: the port in the face's "
        "YAML. For a face with several buses give NAME=PORT, once for each bus."
    ),
]
Bus = Annotated[
    str | None, typer.Option(metavar="NAME", help="For a face with several buses: the bus to use.")
]
Sim = Annotated[
    str | None,
    typer.Option(help="`pty` simulates the servos, at a serial port made for this command."),
]
Rate = Annotated[
    float | None,
    typer.Option(min=30.0, max=200.0, help="Servo loop ticks per second; default: the face's."),
]
DryRun = Annotated[bool, typer.Option("--dry-run", help="Only read the servos, never move them.")]

# ---- which running face ----

FaceName = Annotated[
    str | None, typer.Option("--face", help="Only the face of this name (see `lipservo status`).")
]
Control = Annotated[
    Path | None, typer.Option(help="Control socket of the face; default: found by its name.")
]
On = Annotated[
    Path | None,
    typer.Option(
        metavar="KIOSKS.yaml",
        help="Only the faces on other computers that this file lists (docs/dashboard.md).",
    ),
]

# ---- what it hears ----

Wav = Annotated[
    Path | None, typer.Option(help="Sound file to speak: WAV, FLAC, OGG, any sample rate.")
]
Channel = Annotated[
    str,
    typer.Option(
        metavar="left|right|mix|N",
        help="Channel of the sound: left, right, mix or 1 to 32; default: --config's, or mix.",
        show_default=False,
        callback=refusing(lambda text: text and checked_channel(text)),
    ),
]
Mic = Annotated[
    str | None,
    typer.Option(
        metavar="[DEVICE]",
        help="Listen to a microphone: DEVICE is a number or part of a name (`lipservo devices`); "
        "default: the face's, or the system's.",
    ),
]

# ---- what it says ----

Play = Annotated[
    str | None,
    typer.Option(
        metavar="[DEVICE]",
        help="Also play the sound, delayed to match the lips. DEVICE: a loudspeaker's number or "
        "part of its name, or `silent` (as if played, without a sound device).",
    ),
]
Output = Annotated[
    str | None,
    typer.Option(
        metavar="DEVICE",
        help="Loudspeaker: a number or part of a name (`lipservo devices`); default: the face's.",
    ),
]
Phonemes = Annotated[
    Path | None,
    typer.Option(
        help="Label file, used instead of recognition: phonemes or words with times (TextGrid and "
        "others: docs/text.md)."
    ),
]
Tier = Annotated[
    str,
    typer.Option(
        help="Tier of the label file, by name; default: phonemes, else visemes, else words."
    ),
]
Alphabet = Annotated[str, typer.Option(help="Label file's alphabet: arpabet, ipa, x-sampa, ...")]
SpokenText = Annotated[
    str,
    typer.Option(
        "--text",
        help="English text of the sound, or @FILE; the recogniser then only finds its times.",
        show_default=False,
    ),
]
Listen = Annotated[
    str | None,
    typer.Option(
        metavar="HOST:PORT",
        help="Address for voice agents, HOST:PORT or `none`; other computers need the token.",
        show_default="127.0.0.1:8765, or the next free port",
    ),
]
TokenFile = Annotated[
    Path | None,
    typer.Option(
        help="File whose first line is the access token of the face.",
        show_default="the token of the runtime folder, made at the first start",
    ),
]
OpenToThisComputer = Annotated[
    bool,
    typer.Option(
        "--open-to-this-computer", help="All users of this computer may connect without a token."
    ),
]
Sounds = Annotated[
    Path | None,
    typer.Option(
        help="Folder of sound files and performances that voice agents and the dashboard may play."
    ),
]
Through = Annotated[
    str | None,
    typer.Option(
        "--through",
        metavar="URL",
        help="Let the running face at this address (`lipservo status`) speak.",
    ),
]
# ---- who watches ----

Dashboard = Annotated[
    bool, typer.Option("--dashboard", help="Show the face on a web page, whose address is printed.")
]
DashboardListen = Annotated[
    str | None,
    typer.Option(
        metavar="HOST:PORT",
        help="Address of the web page. On other computers, browsers need the token.",
        show_default="127.0.0.1:8080, or the next free port",
    ),
]
OpenPage = Annotated[bool, typer.Option("--open/--no-open", help="Open the web page in a browser.")]

# ---- how sound becomes motion ----

_ENGINE = typer.Option(
    callback=refusing(lambda name: None if name is None else RECOGNIZERS.check(name)),
    help="Recogniser to start with: network, energy (loudness only) or an installed plug-in; if "
    "it fails, a simpler one takes over.",
    show_default=False,
)
_WEIGHTS = typer.Option(
    help="Recogniser's weights: default, grid (for corpus GRID's speaker), or a .npz file.",
    show_default=False,
)
EngineChoice = Annotated[str, _ENGINE]
MeasuredEngineChoice = Annotated[
    MeasuredEngine,
    typer.Option(help="Recogniser: network, or energy (loudness only).", show_default=False),
]
WeightsChoice = Annotated[str, _WEIGHTS]
#: The same where the face's YAML may say it; then None is `not typed`.
FaceEngine = Annotated[str | None, _ENGINE]
FaceWeights = Annotated[str | None, _WEIGHTS]
FaceStrategy = Annotated[
    Strategy | None,
    typer.Option(
        help="animpho: recorded pieces near the predicted motion; expected: the predicted motion "
        "alone; by Wei and Deng, recorded pieces in the longest chains (priority) or with the "
        f"smoothest joins (naive). Default: the face's, or {DEFAULT_STRATEGY}."
    ),
]
Lookahead = Annotated[
    float | None,
    typer.Option(
        min=0.0,
        max=LONGEST_LOOKAHEAD_MS,
        help="Sound after a phoneme that its motion may use, ms; it delays the face. Default: the "
        "face's, or 100.",
    ),
]
LowLatency = Annotated[
    bool,
    typer.Option(
        "--low-latency", help="Follow the sound within 150 ms, for live puppetry; less precise."
    ),
]
Strength = Annotated[
    float | None,
    typer.Option(
        min=0.0,
        max=STRONGEST,
        help="Amplitude of the mouth's motion; default: the face's, or 1 (the recorded speaker's).",
    ),
]
Smoothness = Annotated[
    float | None,
    typer.Option(min=0.0, max=SMOOTHEST, help="0: crisp motion (default); 1: slow and smooth."),
]
UnitShare = Annotated[
    float | None,
    typer.Option(
        min=0.0,
        max=ONLY_UNITS,
        help="For strategy animpho: share of recorded pieces in the motion, 0 to 1; the rest is "
        "predicted. Default: the face's, or 1.",
    ),
]

# ---- what comes out ----

Trace = Annotated[
    Path | None, typer.Option(help="File to record the servo loop's ticks in (docs/traces.md).")
]
Osc = Annotated[
    str | None,
    typer.Option(
        metavar="HOST[:PORT]",
        help="Also send the face to an avatar (VMC protocol over OSC) at HOST[:PORT], default "
        "39540; HOST:PORT/vowels for avatars with mouth shapes A I U E O alone.",
    ),
]
LiveLink = Annotated[
    str | None,
    typer.Option(
        metavar="HOST[:PORT]",
        help="Also send the face to Unreal Engine (Live Link Face) at HOST[:PORT], default 11111.",
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Show no live view and no messages.")]
SkipBad = Annotated[
    bool, typer.Option("--skip-bad", help="Leave out sentences with faulty files, and list them.")
]
Landmarker = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Path of face_landmarker.task (docs/own-face.md); default: mediapipe's own tracker.",
    ),
]


_OF_THE_YAML: Final = "`{}:` in the face's YAML says it now"
_MOTION: Final = ("engine", "weights", "strategy", "lookahead_ms", "low_latency")
_SET: Final = ("strength", "smoothness", "unit_share")
_MOVED: Final = {
    "--output": _OF_THE_YAML.format("sound.output"),
    "--rate-hz": _OF_THE_YAML.format("rate_hz"),
    **{f"--{name.replace('_', '-')}": _OF_THE_YAML.format(f"motion.{name}") for name in _MOTION},
    **{
        f"--{name.replace('_', '-')}": _OF_THE_YAML.format(f"motion.{name}")
        + f", and `lipservo set {name} VALUE` changes it while the face runs"
        for name in _SET
    },
}
_OF_DAEMON: Final = "`lipservo daemon --dashboard` and `lipservo dashboard` have it"
OPTIONS_OF_THE_PROGRAM: Final = ("-v", "--verbose", "--log-json")
#: Where that is now which was an option, by command.
MOVED_OPTIONS: Final = {
    "run": {
        **_MOVED,
        "--live-link": _OF_THE_YAML.format("avatars.live_link") + "; `lipservo say` has it",
        "--dashboard-listen": _OF_DAEMON,
        "--token-file": _OF_DAEMON,
        "--open-to-this-computer": _OF_DAEMON,
    },
    "daemon": {
        **_MOVED,
        "--osc": _OF_THE_YAML.format("avatars.osc"),
        "--live-link": _OF_THE_YAML.format("avatars.live_link"),
        "--queue": _OF_THE_YAML.format("access.queue"),
        "--sim": "start `lipservo sim-bus`, and name its port with --port",
        "--open": "`lipservo dashboard --open` has it",
    },
}


def port_of(given: str | None, of_the_face: str | None) -> str:
    """Return the port `given` by the user, else the face's. Raises UserError without either."""
    port = given or of_the_face
    if port is None:
        raise UserError("no port: give --port, or write `port:` under `bus:` in the face's YAML")
    return port


def label_file(path: Path | None, tier: str, alphabet: str) -> LabelFile | None:
    """Return the label file that a user names with its tier and alphabet; None: no file.

    Raises UserError for a tier or an alphabet without a file.
    """
    if path is not None:
        return LabelFile(path, tier, alphabet)
    if tier or alphabet:
        raise UserError("--tier and --alphabet need a file of labels; name one")
    return None
