"""What each sentence, key and exit status of a face claims of its servos' torque: a table.

The first pattern that a whole statement matches counts. A statement that none matches is unjudged,
and is listed: a new sentence needs a line here. `{S}` stands for wherever a sentence stands: a
line, a trouble in the status, an error in an answer; `{servo}` for a servo by its name and address.
FACE is the face's name.
"""

import re
from typing import Final

from lipservo_lab.bench.statements.claims import (
    AtLeast,
    Claim,
    Count,
    Each,
    Rule,
    Torque,
    WasOn,
    limp_state,
    nothing,
    sent_pulse,
    unknown,
)

_SHORT: Final = {
    "{S}": r"(?:says|status troubles:|\w+ error:|answer to \w+ error:|outcome problem:) *"
    r"(?:bridge: |speech: |guard: |lipservo: )*(?:FACE: )?"
    r"(?:its processes have died; its guard at \S+: )?(?:could not be started: )?",
    "{servo}": r"servo '(?P<who>\w+)' \((?:id|channel) \d+\)",
    "{limp}": r"(?:limp|pulses off; a digital servo may hold)",
    "{face}": r"says FACE  process \d+  (?:\S+|simulated servos)  ",
    "{n}": r"(?P<n>\d+) servos?",
    "{hold}": r"(?P<n>\d+) of \d+ servos hold",
    # Behind a stop that a full disk did not take.
    "{kept}": r"(?:; the next start of its process will not know of this stop: .*)?",
}
_ALL_OFF: Final = Torque(on=False)
_ALL_ON: Final = Torque(on=True)
_IS_OFF, _IS_ON = Torque(on=False, who="who"), Torque(on=True, who="who")

#: Keys of a status that say what was asked for, how the face is set, or what it hears.
_NOT_OF_TORQUE: Final = (
    r"status (?:name|config|sounds|port|pid|dry_run|bridge_pid|plugged|jogged|word|words|sound"
    r"|recognizer|engine|weights|strategy|hears|moved_by|output|output_lost|listens_on|speaking|arousal"
    r"|units_shifted_ms|mouth_closes|is_resting|delay_ms|fallback_level|fallback_reasons|stopped|stopped_by"
    r"|can_start|torque\.\w+\.age_s|stop_report|n_\w+|\w+_total|(?:settings|expression|capabilities)\.\w+"
    r"|pulses\.\w+\.(?:neutral_us|us_per_deg|min_us|max_us)"
    r"|health\.\w+\.(?:servo_id|temperature_degc|load|voltage_v|current_ma|hardware_errors"
    r"|n_reboots|n_unanswered)|stop_report\.(?:at_s|at_rest|dry_run|released_words)): .*"
)

_STATUS: Final[tuple[tuple[str, Claim], ...]] = (
    (_NOT_OF_TORQUE, nothing),
    (r"status torque_on: null", unknown),
    (r"outcome torque\.\w+\.age_s: .*", nothing),
    (r"status torque_on: true", Torque(on=True, who="any")),
    (r"status torque_on: false", _ALL_OFF),
    (r"(?:status|outcome) (?:torque|health)\.\w+\.(?:torque_)?on: null", unknown),
    (r"(?:status|outcome) (?:torque|health)\.(?P<who>\w+)\.(?:torque_)?on: true", _IS_ON),
    (r"(?:status|outcome) (?:torque|health)\.(?P<who>\w+)\.(?:torque_)?on: false", _IS_OFF),
    (
        r"status (?:servos\.(?P<who>\w+)|health\.(?P<same>\w+)\.state): driven",
        Torque(True, "who|same"),
    ),
    (
        r"status (?:servos\.(?P<who>\w+)|health\.(?P<same>\w+)\.state): off",
        Torque(False, "who|same"),
    ),
    # It gets no goals; whether it holds is told by torque_on.
    (
        r"status (?:servos\.\w+|health\.\w+\.state): "
        r"(?:starting|waiting|cooling|rebooting|failed|switching off|unknown)",
        nothing,
    ),
    (r"status pulses\.\w+\.sent_us: null", unknown),
    (r"status pulses\.(?P<who>\w+)\.sent_us: (?P<us>[\d.]+)", sent_pulse),
    (r"status state: (?:stopped|ended|silent)", limp_state),
    (r"status state: starting", nothing),
    (r"status state: (?:driven|frozen|easing|letting go|unknown)", nothing),
    (r"status state: the bridge .*", nothing),
    (r"status state: (?:has not answered|may not be queried|has just ended|runs).*", nothing),
    (r"status stop_report\.(?:confirmed|released): (?P<who>\w+)", _IS_OFF),
    (r"status stop_report\.unconfirmed\.\w+: .*", unknown),
    (r"status stop_report\.complete: true", _ALL_OFF),
    (r"status stop_report\.complete: false", unknown),
    (r"status error: .*", nothing),
)

_ANSWERS: Final[tuple[tuple[str, Claim], ...]] = (
    (
        r"answer to \w+ (?:accepted|name|config|port|sounds|control|servo|asked|set|value"
        r"|not_kept): .*",
        nothing,
    ),
    (r"answer to \w+ holds: (?P<who>\w+)", _IS_ON),
    (r"answer to \w+ limp: (?P<who>\w+)", _IS_OFF),
    (r"answer to \w+ unknown: (?P<who>\w+)", unknown),
    (
        r"(?:end of \w+|outcome) (?:confirmed|released|limp): "
        r"(?:id |channel )?(?P<who>\w+)(?: at .*)?",
        _IS_OFF,
    ),
    (r"(?:end of \w+|outcome) holds: (?P<who>\w+)", _IS_ON),
    (r"outcome unconfirmed\.(?P<who>\w+): limp: nothing is held", _IS_OFF),
    (r"(?:end of \w+|outcome) unconfirmed\.[\w ]+: .*", unknown),
    (r"(?:end of \w+|outcome) unknown: .*", unknown),
    (r"end of \w+ complete: true", _ALL_OFF),
    (r"end of \w+ complete: false", unknown),
    (
        r"end of \w+ (?:ended|waits|name|config|port|sounds|at_rest|dry_run|released_words"
        r"|exit_status|not_kept): .*",
        nothing,
    ),
    (
        r"outcome (?:name|pid|port|waits|at_rest|dry_run|released_words|servo|asked|face|findings"
        r"|bad_files): .*",
        nothing,
    ),
    (r"outcome problem: ", nothing),
    (r"outcome n_\w+: \d+", nothing),
    (r"outcome servos\.(?P<who>\w+): driven", _IS_ON),
    (r"outcome servos\.(?P<who>\w+): off", _IS_OFF),
    (r"outcome servos\.\w+: (?:waiting|cooling|rebooting|failed|switching off)", nothing),
    (r"outcome servos\.\w+\.\w+: .*", nothing),  # health --json: of days
    (r"outcome state: .*", nothing),
    (r"outcome findings\.what: {servo} gets no pulses", _IS_OFF),
    (r"outcome (?:bad|findings\.(?:remedy|severity|what)): .*", nothing),
)

#: Of one servo, as they stand in `troubles`.
_OF_A_SERVO: Final[tuple[tuple[str, Claim], ...]] = (
    (r"{S}{servo} does not answer(?:; check its power(?: and|,) cable.*)?", unknown),
    (r"{S}{servo} cannot be reached: the port is gone", unknown),
    (r"{S}{servo} limp: a port of the face is gone", _IS_OFF),
    (r"{S}{servo} held: a port of the face is gone", _IS_ON),
    (r"{S}{servo} switched off by a person", _IS_OFF),
    (r"{S}{servo} switched off by a person, has not confirmed yet", unknown),
    (r"{S}{servo} was stopped before its turn", _IS_OFF),
    (r"{S}{servo} (?:lost its torque; not again|has lost its torque)", _IS_OFF),
    (r"{S}{servo} stopped by its watchdog", nothing),
    (r"{S}{servo} .*: it stays limp", _IS_OFF),
    (r"{S}{servo} .*, again and again: given up until a start", unknown),
    (r"{S}{servo} (?:is|was)? ?[\d.]+ deg off for [\d.]+ s.*", nothing),
    (
        r"{S}{servo} [\w ]*(?:overload|overheating|electrical shock|encoder|input voltage)[\w ]*",
        nothing,
    ),
    (r"{S}{servo} too hot", nothing),
    (r"{S}{servo} does not (?:take|switch|say|follow|move|reach).*", unknown),
    (r"{S}{servo} has had no pulse yet, .*", _IS_OFF),
    (r"{S}{servo} is not driven yet", unknown),
)

#: Of the whole face, in logs and answers.
_OF_A_FACE: Final[tuple[tuple[str, Claim], ...]] = (
    (r"says .* \(and \d+ times more\)", nothing),  # how often a line came that was judged
    (
        r"{S}stopped; the face is (?:at rest and )?limp: confirmed by {n}(?:; .*)?",
        AtLeast(on=False),
    ),
    (r"{S}stopped; (?:at rest, )?{n} let go, not confirmed: {limp}(?:; .*)?", AtLeast(on=False)),
    (r"{S}(?:ended; )?{n} let go, not confirmed: {limp}(?:; .*)?", AtLeast(on=False)),
    (r"{S}torque off was confirmed by {n}, NOT by .*", AtLeast(on=False)),
    (r"{S}(?:ended; )?torque off confirmed by all {n}", AtLeast(on=False)),
    (r"{S}(?:ended; )?torque off confirmed by {n}, NOT by .*", AtLeast(on=False)),
    (r"{S}(?:ended; )?(?:\d+ servos? )?may still be driven:? ?.*", unknown),
    (r"says (?:bridge: )?  \w+: .*", unknown),  # each that has not confirmed, and why
    (r"{S}keep your hands away; .*", nothing),
    (r"(?:{S}|says FACE: )dry run over; no torque was switched on", _ALL_OFF),
    (r"{S}every servo (?:is driven|holds) again", _ALL_ON),
    (r"{S}motion comes again", nothing),
    (r"{S}(?:the servo loop missed|no new motion|servo loop and speech are in).*", nothing),
    # What is done; what came of it, each servo's torque says.
    (r"{S}no motion comes from speech .*: torque is switched off until it comes", unknown),
    (r"{S}the port of the servos is (?:gone|back)", nothing),
    (r"{S}the port is (?:gone|back).*", nothing),
    (r"{S}start requested by .*: driven again", Torque(on=True, who="any")),
    (r"{S}start requested by .*", nothing),
    (r"{S}stop(?:ping)?(?: requested)?: .*by .*", nothing),
    (r"{S}stopping: SIG\w+", nothing),
    (r"{S}frozen: held until the next stop", nothing),
    (r"{S}torque cannot be switched off yet: .*", unknown),
    (r"{S}not driven until `lipservo start`: .*", nothing),
    (r"{S}stays {limp}: (?P<who>\w+): .*", _IS_OFF),
    (r"{S}critical {servo} .*; all is {limp}", _ALL_OFF),
    (r"{S}critical {servo} .*; the face was stopped", nothing),
    (r"{S}servo \w+ (?:off|on|reboot): .*", nothing),
    # What may be, and what becomes of servos when the computer dies: no state of now.
    (r"says (?:stop|stop --limp|stop --freeze|computer dies, or the plug is pulled): .*", nothing),
    (r"{S}nothing holds the OE pin of the board: .*", nothing),
    (r"{S}no guard runs: .*", nothing),
    (r"{S}`lipservo doctor` (?:shows|examines) every .*", nothing),
    (r"{S}the program is over: the next stop ends it", nothing),
    (r"{S}(?:speech|bridge) (?:runs as process|died|hangs|has not ended).*", nothing),
    (r"{S}strategy .*", nothing),
    (r"{S}recogniser .*", nothing),
    (r"{S}(?:\d+ lines were lost).*", nothing),
    (r"{S}simulated.*", nothing),
    (r"{S}\S+: (?:no such port|no such I2C bus|no \w+ answers|used by another).*", unknown),
    (r"{S}\S+, address \S+: .*", unknown),
    (r"{S}could not be started .*", nothing),
)

#: What the commands answer.
_OF_COMMANDS: Final[tuple[tuple[str, Claim], ...]] = (
    (r"says FACE: (?:at rest and )?limp(?:, confirmed by all {n})?(?:; it waits: .*)?", _ALL_OFF),
    (
        r"says FACE: {limp} \({n}\)(?:; confirmed by \d+ servos)?(?:; it waits: .*)?",
        AtLeast(on=False),
    ),
    (r"says \S+: {limp}(?:, confirmed by all {n}| \(\d+ servos?\))?(?:; .*)?", _ALL_OFF),
    (r"says \S+: confirmed by {n}, NOT by .*", AtLeast(on=False)),
    (r"says FACE hangs: it does not answer; processes .* are killed", nothing),
    (
        r"says FACE: held where it is: {n} holds?(?:; (?P<limp>[\w, ]+) limp)?"
        r"(?:; not known of [\w, ]+)?{kept}",
        Each(AtLeast(on=True), Torque(on=False, who="limp")),
    ),
    (r"says FACE: nothing is held(?:; \d+ servos? limp)?{kept}", _ALL_OFF),
    (r"says FACE: nothing is known to be held; .*", unknown),
    (r"says FACE: servo \w+ comes on when the face is started", nothing),
    (r"says FACE: servo (?P<who>\w+) stays off when the face is started", _IS_OFF),
    (r"(?:{S}|{face})[\w ]+, {hold}(?:, not known of (?P<unknown>\d+))?", Count(on=True)),
    (r"{S}driven, it is not known which servos hold", unknown),
    (r"says bridge: {servo} holds already: its torque was on before the start", _IS_ON),
    (r"says \w+ was too slow for .*", nothing),
    (r"{S}will stop, but has not confirmed it within .*", unknown),
    (r"{S}(?:hangs:|has not answered) .*", unknown),
    (r"{S}(?:servo \w+ )?has (?:gone|just ended|not restarted).*", unknown),
    (r"{S}not driven(?: within .*)?: .*", nothing),
    (r"says FACE: servo (?P<who>\w+) is driven", _IS_ON),
    (r"says FACE: servo (?P<who>\w+) is off", _IS_OFF),
    (r"{S}servo \w+ is (?:waiting|cooling|rebooting|failed|unknown|switching off)", unknown),
    (r"{S}'\w+': no such servo; .*", nothing),
    (r"{S}the face is (?:driven already|stopping: .*|being started already)", nothing),
    (r"{S}the face is (?:stopped by a person.*|letting go|ended|stopped|frozen): .*", nothing),
    (r"{S}the bridge .*", nothing),
    (r"{S}stopped: ask again once the face is driven", nothing),
    (r"{S}no bridge drives the servos just now; ask again", nothing),
    (r"{S}no face (?:runs|answers).*", nothing),
    # `status`: a line for each face.
    (r"{face}\w+, but its port is gone: no servo can be reached", unknown),
    (
        r"{face}stopped by .*: (?:.*; )?limp, confirmed by {n}(?:, NOT by .*)?(?:; .*)?",
        AtLeast(on=False),
    ),
    (r"{face}stopped by .*: {limp}(?:; .*)?", _ALL_OFF),
    (r"{face}.*", nothing),
    (r"says   (?:silence|\S+\.flac): .*", nothing),
    # The frame and the counts that a `run` leaves behind.
    (r"says .* -> FACE +torque off", _ALL_OFF),
    (r"says .* -> FACE +torque on", Torque(on=True, who="any")),
    (r"says  *\w+ +[─●]+ +-?[\d.]+ deg", nothing),
    (r"says \S+\.flac(?:: no speech was found in .*)?", nothing),
    (r"says animpho, .*", nothing),
    (r"says delay from sound to face: .*", nothing),
    (r"says (?:lip gap|phonemes) .*", nothing),
    (
        r"says  [a-z0-9 ]+  +\S.*  +(?:good: .*|goals sent to every servo|the face is so .*)",
        nothing,
    ),
    (r"says  [a-z0-9 ]+  +\S.*  +(?:from the start of .*|a few are normal; .*)", nothing),
    (r"says  [a-z0-9 ]+  +\S.*  +(?:of sound.*|moved the mouth|the most memory used)", nothing),
    (r"says  seconds +[\d.]+ +the whole run took", nothing),
    (r"says sound +[\d.]+ s", nothing),
    # `calibrate neutral`.
    (r"says (?P<who>\w+) was sent to .* deg(?: \(.* us\))?", WasOn("who")),
    (r"says (?P<who>\w+) stands at .* deg(?: \(.* us\))?", WasOn("who")),
)

#: `doctor` and `health` tell of settings and of days past; but it is told which servos hold now.
_OF_DOCTOR: Final[tuple[tuple[str, Claim], ...]] = (
    (r"says ok   {servo} gets no pulses", _IS_OFF),
    (r"says ok   (?P<who>\w+): channel \d+, no pulses; .*", _IS_OFF),
    (r"says (?:ok  |warn) (?:makes|pulses [\d.]+|clock_hz|nothing holds|these servos) .*", nothing),
    (r"says \w+ +{servo} gets pulses.*", _IS_ON),
    (r"says (?:ok  |warn|FAIL|fail|info) (?!.*\b(?:torque|holds?|limp|pulses)\b).*", nothing),
    (r"says BAD +\w+ \((?:id|channel) \d+\) does not answer -> .*", unknown),
    (r"says  *servo +°C now .*", nothing),
    (r"says  *\w+ +(?:[-\d.%]+ +){5}[\w ]+ +\d+ +\d+", nothing),
    (r"says - .*", nothing),
    (r"says   its supply is failing", nothing),
    (r"says .* readings", nothing),
    (r"says nothing (?:is getting worse|logged yet).*", nothing),
)

#: 0: as it was asked for.
_EXITS: Final[tuple[tuple[str, Claim], ...]] = (
    (r"exit stop(?: --limp| --end| --json)?: 0", _ALL_OFF),
    (r"exit stop --freeze: 0", Torque(on=True, who="any")),
    (r"exit start(?: --json)?: 0", _ALL_ON),
    (r"exit servo (?P<who>\w+) off: 0", _IS_OFF),
    (r"exit servo (?P<who>\w+) on: 0", _IS_ON),
    (r"exit servo \w+ on of a stopped face: 0", nothing),  # it comes on with the face
    (r"exit limp .*: 0", _ALL_OFF),
    (r"exit (?:daemon|run .*): [05]", _ALL_OFF),  # it ended well, or early, and all confirmed
    (r"exit (?:daemon|run .*): 3", unknown),
    (r"exit calibrate neutral .*: 0", _ALL_OFF),
    (r"exit (?:stop|start|servo|limp|calibrate|daemon|run)\b.*: -?\d+", nothing),
    (r"exit daemon at a port in use: [1-9]", nothing),
    (r"exit (?:status|doctor|health|servo)\b.*: \d+", nothing),
)


def _made(pattern: str, claim: Claim) -> Rule:
    for short, whole in _SHORT.items():
        pattern = pattern.replace(short, whole)
    return Rule(re.compile(pattern), claim)


RULES: Final = tuple(
    _made(*each)
    for table in (_STATUS, _ANSWERS, _OF_A_SERVO, _OF_A_FACE, _OF_COMMANDS, _OF_DOCTOR, _EXITS)
    for each in table
)
