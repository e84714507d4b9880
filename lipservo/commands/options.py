"""The options of commands, each declared once.

Quick commands such as `stop` import this module: it loads nothing that takes long.
"""

from pathlib import Path
from typing import Annotated, Final

import typer

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
from lipsync.plugins import RECOGNIZERS, PluginError

DEFAULT_FACE = "face_sim"


def _channel(text: str) -> str:
    try:
        return text and checked_channel(text)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error


# ---- which face ----

Config = Annotated[
    str, typer.Option(help="Face: the name of a shipped one, or the path of a YAML file.")
]
Model = Annotated[
    Path | None,
    typer.Option(help="Face model (.npz); default: the shipped one.", show_default=False),
]
Port = Annotated[
    str | None,
    typer.Option(
        help="Serial port of the servos, such as /dev/ttyUSB0; default: the face's. "
        "Of several buses NAME=PORT, once for each.",
        show_default=False,
    ),
]
Bus = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Which bus, of a face with several.", show_default=False),
]
Sim = Annotated[
    str | None,
    typer.Option(help="`pty`: simulated servos behind a port of their own.", show_default=False),
]
Rate = Annotated[
    float | None,
    typer.Option(
        min=30.0, max=200.0, help="Frames a second; default: the face's.", show_default=False
    ),
]
DryRun = Annotated[bool, typer.Option("--dry-run", help="Read the servos, never move them.")]

# ---- which running face ----

FaceName = Annotated[
    str | None, typer.Option("--face", help="Only the face of this name.", show_default=False)
]
Control = Annotated[
    Path | None, typer.Option(help="Socket that the face listens on.", show_default=False)
]
On = Annotated[
    Path | None,
    typer.Option(
        metavar="KIOSKS.yaml",
        help="The faces of other computers that this file lists.",
        show_default=False,
    ),
]

# ---- what it hears ----

Wav = Annotated[
    Path | None, typer.Option(help="Sound file: WAV, FLAC, OGG, any rate.", show_default=False)
]
Channel = Annotated[
    str,
    typer.Option(
        metavar="left|right|mix|N",
        help="Channel that is heard; default: the face's, or mix.",
        show_default=False,
        callback=_channel,
    ),
]
Mic = Annotated[
    str | None,
    typer.Option(
        metavar="[DEVICE]",
        help="Listen to a microphone: the default one, or a number or part of a name.",
        show_default=False,
    ),
]

# ---- what it says ----

Play = Annotated[
    str | None,
    typer.Option(
        metavar="[DEVICE]",
        help="Play the sound, delayed to match the lips; silent: into nothing, without a device.",
        show_default=False,
    ),
]
Output = Annotated[
    str | None,
    typer.Option(
        metavar="DEVICE",
        help="Loudspeaker for --play: a number, a name, or a part of it; default: the face's.",
        show_default=False,
    ),
]
Phonemes = Annotated[
    Path | None,
    typer.Option(
        help="Phonemes or words with times, in place of recognition: TextGrid, MFA, speech marks.",
        show_default=False,
    ),
]
Tier = Annotated[str, typer.Option(help="Tier of that file; `words`: no phonemes.")]
Alphabet = Annotated[str, typer.Option(help="Alphabet of its labels: arpabet, ipa, x-sampa, ...")]
SpokenText = Annotated[
    str,
    typer.Option(
        "--text",
        help="What the file says, in English: followed in its sound. Or @FILE.",
        show_default=False,
    ),
]
Listen = Annotated[
    str | None,
    typer.Option(
        metavar="HOST:PORT",
        help="Address for voice agents, or `none`; other computers need the token.",
        show_default="127.0.0.1:8765, or the next free port",
    ),
]
TokenFile = Annotated[
    Path | None,
    typer.Option(
        help="File whose first line voice agents and browsers must send.",
        show_default="the token of the runtime folder, made at the first start",
    ),
]
OpenToThisComputer = Annotated[
    bool,
    typer.Option(
        "--open-to-this-computer", help="Any user of this computer may connect without the token."
    ),
]
Sounds = Annotated[
    Path | None,
    typer.Option(
        help="Folder of sound files and performances that agents and the dashboard may play.",
        show_default=False,
    ),
]
Through = Annotated[
    str | None,
    typer.Option(
        "--through",
        metavar="URL",
        help="Let a running face say it; `lipservo status` tells its address.",
        show_default=False,
    ),
]
# ---- who watches ----

Dashboard = Annotated[
    bool, typer.Option("--dashboard", help="Show the face in a browser; the address is printed.")
]
DashboardListen = Annotated[
    str | None,
    typer.Option(
        metavar="HOST:PORT",
        help="Where the dashboard is. Beyond loopback with a token.",
        show_default="127.0.0.1:8080, or the next free port",
    ),
]
OpenPage = Annotated[
    bool, typer.Option("--open/--no-open", help="Open the dashboard in a browser.")
]

# ---- how sound becomes motion ----


def _known_engine(name: str | None) -> str | None:
    try:
        return None if name is None else RECOGNIZERS.check(name)
    except PluginError as error:
        raise typer.BadParameter(str(error)) from error


_ENGINE = typer.Option(
    callback=_known_engine,
    help="Recogniser to begin with: network, energy, or another package's; if it fails, a "
    "simpler one takes over.",
    show_default=False,
)
_WEIGHTS = typer.Option(
    help="What the network has learned: default, grid, or a file of weights.", show_default=False
)
EngineChoice = Annotated[str, _ENGINE]
MeasuredEngineChoice = Annotated[
    MeasuredEngine,
    typer.Option(help="Recogniser.", show_default=False),
]
WeightsChoice = Annotated[str, _WEIGHTS]
#: The same where the face's YAML may say it; then None is `not typed`.
FaceEngine = Annotated[str | None, _ENGINE]
FaceWeights = Annotated[str | None, _WEIGHTS]
FaceStrategy = Annotated[
    Strategy | None,
    typer.Option(
        help="How phonemes become motion: animpho, expected, or the paper's naive, priority; "
        f"default: the face's, or {DEFAULT_STRATEGY}.",
        show_default=False,
    ),
]
Lookahead = Annotated[
    float | None,
    typer.Option(
        min=0.0,
        max=LONGEST_LOOKAHEAD_MS,
        help="Delay the face to see what sound follows; default: 100, or the face's.",
        show_default=False,
    ),
]
LowLatency = Annotated[
    bool,
    typer.Option(
        "--low-latency", help="For puppeteers: goals within 150 ms of the sound, less precise."
    ),
]
Strength = Annotated[
    float | None,
    typer.Option(
        min=0.0,
        max=STRONGEST,
        help="How far the mouth moves; 1, the default, as the speaker's.",
        show_default=False,
    ),
]
Smoothness = Annotated[
    float | None,
    typer.Option(min=0.0, max=SMOOTHEST, help="0, the default, crisp, 1 slow.", show_default=False),
]
UnitShare = Annotated[
    float | None,
    typer.Option(
        min=0.0,
        max=ONLY_UNITS,
        help="With animpho: 0: predicted motion only; 1: recorded motion only.",
        show_default=False,
    ),
]

# ---- what comes out ----

Trace = Annotated[
    Path | None, typer.Option(help="Write every tick to this file.", show_default=False)
]
Osc = Annotated[
    str | None,
    typer.Option(
        metavar="HOST[:PORT][/vowels]",
        help="Show the face on an avatar, too: VMC protocol over OSC; port 39540. /vowels: A I U "
        "E O, for avatars without ARKit's shapes.",
        show_default=False,
    ),
]
LiveLink = Annotated[
    str | None,
    typer.Option(
        metavar="HOST[:PORT]",
        help="Show the face in Unreal Engine, too: Live Link Face; port 11111.",
        show_default=False,
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No live view, no messages.")]
SkipBad = Annotated[
    bool, typer.Option("--skip-bad", help="Leave out sentences with a bad file, and list them.")
]
Landmarker = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Track faces with this face_landmarker.task rather than with mediapipe "
        "(docs/own-face.md).",
        show_default=False,
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
