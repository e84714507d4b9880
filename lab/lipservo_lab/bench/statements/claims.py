"""What a sentence claims of torque, and whether the servos' own log agrees.

A rule is data: the pattern of a sentence, a key or an exit status, and what that claims. A claim is
true where it was so at some moment from a little before the sentence was requested until it was
heard. What is called unknown is never untrue, and is counted.
"""

import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Final

from firmware_bridge.joints import Joint
from lipservo_lab.bench.stops.logged_device import LoggedDevice, Moment

#: What is known of a servo may be so old: each is asked in its turn, and a line takes its way.
OLD_S: Final = 0.3
#: A pulse that goes slowly is sent on while it is told; and a Maestro goes to a pulse that is far,
#: after a tick that came late, at its own speed.
_PULSE_US, _RAMP_S = 60.0, 1.0
#: Between two troubles in one line.
_NEXT_TROUBLE: Final = re.compile(r"; (?=servo '|recogniser |the servo loop |no new )")
#: Before the sentence itself.
_KIND: Final = re.compile(r"\w+ (?:[\w ]+: )?")


@dataclass(frozen=True, slots=True)
class Statement:
    """A statement: requested at `since_s`, heard at `until_s`, monotonic seconds.

    text: with the kind before it, as `status servos.jaw: driven`. about: the object that it is part
    of; of a line: `began_s`, when its process was started.
    """

    text: str
    since_s: float
    until_s: float
    about: Mapping[str, Any] = field(default_factory=dict)


class Verdict(StrEnum):
    """What came of a statement."""

    TRUE = "true"
    UNTRUE = "untrue"
    UNKNOWN = "unknown"  # it says that it is not known, or that it may be either
    SILENT = "silent"  # says nothing of torque
    UNJUDGED = "unjudged"  # no rule knows it


#: Those of statements that claim something.
_CLAIMS: Final = (Verdict.TRUE, Verdict.UNTRUE, Verdict.UNKNOWN)


@dataclass(frozen=True, slots=True)
class Heard:
    """A statement that a rule knows, the match, and the servos that it may be about."""

    statement: Statement
    match: re.Match[str]
    device: LoggedDevice
    names: tuple[str, ...]
    addresses: tuple[int, ...]

    @property
    def records(self) -> list[Moment]:
        """The records of the log from shortly before the statement's request until its arrival."""
        made = self.statement
        return self.device.during(made.since_s - OLD_S, made.until_s)

    def servos(self, who: str) -> list[int]:
        """Return indices of the servos: of `all`, or of those that the group `who` names."""
        if who == "all":
            return list(range(len(self.names)))
        text = next(filter(None, (self.match[each] for each in who.split("|"))))
        words = re.findall(r"[\w]+", text)
        found = [n for n, name in enumerate(self.names) if name in words]
        if found:
            return found
        numbers = [int(each) for each in words if each.isdigit()]
        return [n for n, address in enumerate(self.addresses) if address in numbers]


Claim = Callable[[Heard], Verdict]


def _verdict(*, holds: bool) -> Verdict:
    return Verdict.TRUE if holds else Verdict.UNTRUE


def nothing(_heard: Heard) -> Verdict:
    """Claim nothing about torque."""
    return Verdict.SILENT


def unknown(_heard: Heard) -> Verdict:
    """Claim that torque is unknown, or that it may be on or off."""
    return Verdict.UNKNOWN


@dataclass(frozen=True, slots=True)
class Torque:
    """Servos are on, or off. who: `all`, `any`, or the group of the pattern that names them."""

    on: bool
    who: str = "all"

    def __call__(self, heard: Heard) -> Verdict:
        """Judge whether the claim was true at some moment while the statement was made."""
        if self.who == "any":
            return _verdict(holds=any(any(each.on) for each in heard.records))
        servos = heard.servos(self.who)
        if not servos:
            return Verdict.UNTRUE  # it names nobody of this face
        return _verdict(
            holds=any(all(each.on[n] is self.on for n in servos) for each in heard.records)
        )


@dataclass(frozen=True, slots=True)
class AtLeast:
    """At least as many servos as the group `count` says are on, or off."""

    on: bool
    count: str = "n"

    def __call__(self, heard: Heard) -> Verdict:
        """Judge whether the claim was true at some moment while the statement was made."""
        n = min(int(heard.match[self.count]), len(heard.names))  # a board may have more channels
        return _verdict(
            holds=any(sum(on is self.on for on in each.on) >= n for each in heard.records)
        )


@dataclass(frozen=True, slots=True)
class Count:
    """Exactly as many servos as the group `count` says are on, or off.

    With a group `unknown`: up to so many more.
    """

    on: bool
    count: str = "n"

    def __call__(self, heard: Heard) -> Verdict:
        """Judge whether the claim was true at some moment while the statement was made."""
        n = int(heard.match[self.count])
        allowed = range(n, n + int(heard.match.groupdict().get("unknown") or 0) + 1)
        return _verdict(
            holds=any(sum(on is self.on for on in each.on) in allowed for each in heard.records)
        )


@dataclass(frozen=True, slots=True, init=False)
class Each:
    """Several claims of one sentence; those whose group is not in it are left out."""

    claims: tuple[Claim, ...]

    def __init__(self, *claims: Claim) -> None:
        object.__setattr__(self, "claims", claims)

    def __call__(self, heard: Heard) -> Verdict:
        """Judge all claims of a sentence: untrue where one of them is."""
        named = heard.match.groupdict()
        found = [each(heard) for each in self.claims if named.get(getattr(each, "who", ""), "-")]
        return Verdict.UNTRUE if Verdict.UNTRUE in found else found[0]


@dataclass(frozen=True, slots=True)
class WasOn:
    """Servos have had torque, or pulses, since the process was started that says so."""

    who: str

    def __call__(self, heard: Heard) -> Verdict:
        """Judge whether each of the servos had torque at some moment since the process began."""
        made = heard.statement
        began_s = float(made.about.get("began_s", made.since_s))
        records = heard.device.during(began_s, made.until_s)
        servos = heard.servos(self.who)
        return _verdict(holds=all(any(each.on[n] for each in records) for n in servos))


def limp_state(heard: Heard) -> Verdict:
    """A state that means limp, but for servos of which the same object says otherwise."""
    about = heard.statement.about
    doubted = [each["name"] for each in about.get("health", ()) if each["torque_on"] is not False]
    doubted += (about.get("stop_report") or {}).get("unconfirmed", ())
    limp = [n for n, name in enumerate(heard.names) if name not in doubted]
    if any(not any(each.on[n] for n in limp) for each in heard.records):
        return Verdict.TRUE
    return Verdict.UNKNOWN if about.get("torque_on") is None else Verdict.UNTRUE


def sent_pulse(heard: Heard) -> Verdict:
    """Judge `sent_us` of a servo: the pulse that the servo gets, or got last."""
    (index,), us = heard.servos("who"), float(heard.match["us"])
    later = heard.device.during(heard.statement.until_s, heard.statement.until_s + _RAMP_S)
    for each in (*heard.records, *later):
        if each.on[index] and abs(each.pulses_us[index] - us) <= _PULSE_US:
            return Verdict.TRUE
    if any(each.on[index] for each in heard.records):
        return Verdict.UNTRUE
    before = heard.device.during(0.0, heard.statement.until_s)
    last = next((each for each in reversed(before) if each.on[index]), None)
    return _verdict(holds=last is not None and abs(last.pulses_us[index] - us) <= _PULSE_US)


@dataclass(frozen=True, slots=True)
class Rule:
    """A pattern that a whole statement matches, and what it claims then."""

    pattern: re.Pattern[str]
    claim: Claim

    @property
    def any_value(self) -> bool:
        """Whether the rule matches a key with any value."""
        return self.pattern.pattern.endswith(": .*")


@dataclass(slots=True)
class Tally:
    """What came of many statements.

    templates: the different ones that claimed something. listed: of what was untrue or unjudged,
    how often each was made, and one of them with what the log showed.
    """

    verdicts: Counter[Verdict] = field(default_factory=Counter)
    templates: set[str] = field(default_factory=set)
    listed: dict[tuple[Verdict, str, str], tuple[int, str]] = field(default_factory=dict)

    def add(self, verdict: Verdict, short: str, where: str = "", example: str = "") -> None:
        """Count one. short: its template. where: its bus and scene."""
        self.verdicts[verdict] += 1
        if verdict in _CLAIMS:
            self.templates.add(short)
        if verdict in (Verdict.UNTRUE, Verdict.UNJUDGED):
            n, first = self.listed.get((verdict, short, where), (0, example))
            self.listed[verdict, short, where] = n + 1, first

    def join(self, other: "Tally") -> None:
        """Take in another one."""
        self.verdicts += other.verdicts
        self.templates |= other.templates
        for key, (n, example) in other.listed.items():
            mine, first = self.listed.get(key, (0, example))
            self.listed[key] = mine + n, first

    @property
    def lines(self) -> list[str]:
        """A line for each different sentence of a scene that was untrue, or that no rule knows."""
        return [
            f"{where}: {verdict}, {n} times: {example}"
            for (verdict, _, where), (n, example) in sorted(self.listed.items())
        ]

    @property
    def figures(self) -> dict[str, Any]:
        """Return how many statements claimed something, how many were different, how many untrue.

        unjudged: no rule matches them. unknown_share: share of the claims that torque is not known.
        says_nothing: statements that by a rule claim nothing about torque.
        """
        n_claims = sum(self.verdicts[each] for each in _CLAIMS)
        return {
            "statements": n_claims,
            "templates": len(self.templates),
            "untrue": self.verdicts[Verdict.UNTRUE],
            "unjudged": self.verdicts[Verdict.UNJUDGED],
            "unknown_share": self.verdicts[Verdict.UNKNOWN] / n_claims if n_claims else 0.0,
            "says_nothing": self.verdicts[Verdict.SILENT],
        }


class Judge:
    """Holds statements against the log of one robot by a table of rules."""

    def __init__(
        self, rules: Sequence[Rule], device: LoggedDevice, joints: Sequence[Joint], face: str
    ) -> None:
        """joints: in the order of the log. face: its name."""
        self._rules, self._device = tuple(rules), device
        self._names = tuple(each.name for each in joints)
        self._addresses = tuple(each.servo_id for each in joints)
        self._faces = tuple(dict.fromkeys((face, face.replace(" ", "_"), face.replace(" ", "-"))))
        self._silent: set[str] = set()

    def judge(self, statements: Iterable[Statement], where: str = "") -> Tally:
        """Judge statements: each sentence in them, by the first rule that it matches."""
        tally = Tally()
        for made in statements:
            key = made.text.partition(": ")[0]
            if key in self._silent:  # whatever the number
                tally.verdicts[Verdict.SILENT] += 1
                continue
            for text in self._sentences(made.text):
                self._judge(made, text, where, tally)
        return tally

    def _judge(self, made: Statement, text: str, where: str, tally: Tally) -> None:
        """Add to `tally` what the first matching rule makes of one sentence.

        Without a rule the sentence counts as `Verdict.UNJUDGED`. For an untrue one, the torque that
        was logged meanwhile is appended to the example.
        """
        short = template(text, self._names)
        found = ((rule, rule.pattern.fullmatch(text)) for rule in self._rules)
        rule, match = next(((r, m) for r, m in found if m is not None), (None, None))
        if rule is None or match is None:
            tally.add(Verdict.UNJUDGED, short, where, text)
            return
        heard = Heard(made, match, self._device, self._names, self._addresses)
        verdict, truth = rule.claim(heard), ""
        if verdict is Verdict.SILENT and text.startswith("status ") and rule.any_value:
            self._silent.add(text.partition(": ")[0])
        if verdict is Verdict.UNTRUE:
            seen = dict.fromkeys("".join("01"[on] for on in m.on) for m in heard.records)
            truth = f" [torque was {', '.join(seen)}; state {made.about.get('state')}]"
        tally.add(verdict, short, where, f"{text}{truth}")

    def _sentences(self, text: str) -> list[str]:
        """Several troubles may stand in one line."""
        for face in self._faces:
            text = text.replace(face, "FACE")
        first, *others = _NEXT_TROUBLE.split(text)
        kind = _KIND.match(text)
        return [first, *(f"{kind[0] if kind else ''}{each}" for each in others)]


def template(text: str, names: Iterable[str]) -> str:
    """A sentence without numbers, names and places, so that equal ones are counted once.

    An exit status is no number.
    """
    text = re.sub(r"(?<![\w.])/[^\s:,;]+", "PATH", text)
    for name in sorted(names, key=len, reverse=True):
        text = re.sub(rf"\b{re.escape(name)}\b", "NAME", text)
    text = re.sub(r"NAME(, NAME)+", "NAMES", text)
    if text.startswith("exit "):
        return text
    return re.sub(r"\d+(\.\d+)?([eE][-+]?\d+)?", "N", text)
