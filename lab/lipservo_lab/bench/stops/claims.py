"""What a sentence claims of torque, and whether the servos' own log agrees.

A rule is data: the pattern of a sentence, a key or an exit status, and what that claims. A claim is
true where it was so at some moment from a little before the sentence was asked for until it was
heard. What is said to be unknown is never untrue, and is counted.
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
#: A pulse that goes slowly is sent on while it is told.
_PULSE_US: Final = 60.0
#: Between two troubles in one line.
_NEXT_TROUBLE: Final = re.compile(r"; (?=servo '|recogniser )")
#: Before the sentence itself.
_KIND: Final = re.compile(r"\w+ (?:[\w ]+: )?")


@dataclass(frozen=True, slots=True)
class Statement:
    """Something that was said: asked for at `since_s`, heard at `until_s`, monotonic seconds.

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


@dataclass(frozen=True, slots=True)
class Heard:
    """A statement that a rule knows, the match, and the servos that it may be about."""

    statement: Statement
    match: re.Match[str]
    device: LoggedDevice
    names: tuple[str, ...]
    addresses: tuple[int, ...]

    @property
    def moments(self) -> list[Moment]:
        """What was so while it was said."""
        said = self.statement
        return self.device.during(said.since_s - OLD_S, said.until_s)

    def servos(self, who: str) -> list[int]:
        """Indices of the servos: of `all`, or of those that the group `who` names."""
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
    """It says nothing of torque."""
    return Verdict.SILENT


def unknown(_heard: Heard) -> Verdict:
    """It says that nobody knows, or that it may be either."""
    return Verdict.UNKNOWN


@dataclass(frozen=True, slots=True)
class Torque:
    """Servos are on, or off. who: `all`, `any`, or the group of the pattern that names them.

    but: a group, or a key of the object, whose servos are left out.
    """

    on: bool
    who: str = "all"
    but: str = ""

    def __call__(self, heard: Heard) -> Verdict:
        """Whether it was so at some moment."""
        if self.who == "any":
            return _verdict(holds=any(any(each.on) for each in heard.moments))
        servos = [n for n in heard.servos(self.who) if n not in self._left_out(heard)]
        if not servos and self.who != "all":
            return Verdict.UNTRUE  # it names nobody
        return _verdict(
            holds=any(all(each.on[n] is self.on for n in servos) for each in heard.moments)
        )

    def _left_out(self, heard: Heard) -> list[int]:
        if not self.but:
            return []
        if self.but in heard.match.re.groupindex:
            return heard.servos(self.but) if heard.match[self.but] else []
        found: Any = heard.statement.about
        for key in self.but.split("."):
            found = (found or {}).get(key) or {}
        return [n for n, name in enumerate(heard.names) if name in found]


@dataclass(frozen=True, slots=True)
class AtLeast:
    """At least as many servos as the group `count` says are on, or off."""

    on: bool
    count: str = "n"

    def __call__(self, heard: Heard) -> Verdict:
        """Whether it was so at some moment."""
        n = int(heard.match[self.count])
        return _verdict(
            holds=any(sum(on is self.on for on in each.on) >= n for each in heard.moments)
        )


@dataclass(frozen=True, slots=True)
class Count:
    """Exactly as many servos as the group `count` says are on, or off."""

    on: bool
    count: str = "n"

    def __call__(self, heard: Heard) -> Verdict:
        """Whether it was so at some moment."""
        n = int(heard.match[self.count])
        return _verdict(
            holds=any(sum(on is self.on for on in each.on) == n for each in heard.moments)
        )


@dataclass(frozen=True, slots=True)
class WasOn:
    """Servos have had torque, or pulses, since the process was started that says so."""

    who: str

    def __call__(self, heard: Heard) -> Verdict:
        """Whether each of them had."""
        said = heard.statement
        began_s = float(said.about.get("began_s", said.since_s))
        moments = heard.device.during(began_s, said.until_s)
        servos = heard.servos(self.who)
        return _verdict(holds=all(any(each.on[n] for each in moments) for n in servos))


def sent_pulse(heard: Heard) -> Verdict:
    """`sent_us` of a servo: the pulse that it gets, or got last."""
    (index,), us = heard.servos("who"), float(heard.match["us"])
    for each in heard.moments:
        if each.on[index] and abs(each.pulses_us[index] - us) <= _PULSE_US:
            return Verdict.TRUE
    if any(each.on[index] for each in heard.moments):
        return Verdict.UNTRUE
    before = heard.device.during(0.0, heard.statement.until_s)
    last = next((each for each in reversed(before) if each.on[index]), None)
    return _verdict(holds=last is not None and abs(last.pulses_us[index] - us) <= _PULSE_US)


@dataclass(frozen=True, slots=True)
class Rule:
    """A pattern that a whole statement matches, and what it claims then."""

    pattern: re.Pattern[str]
    claim: Claim


@dataclass(frozen=True, slots=True)
class Judged:
    """One sentence and what came of it. template: without numbers and names. where: bus, scene."""

    text: str
    template: str
    verdict: Verdict
    where: str = ""
    truth: str = ""

    def __str__(self) -> str:
        return f"{self.where}: {self.text} [{self.truth}]"


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
        self._known: dict[str, Rule | None] = {}

    def judge(self, said: Statement, where: str = "") -> list[Judged]:
        """What came of a statement: of each sentence in it, by the first rule that it matches."""
        return [self._judged(said, text, where) for text in self._sentences(said.text)]

    def _judged(self, said: Statement, text: str, where: str) -> Judged:
        rule = self._rule(text)
        short = template(text, self._names)
        if rule is None:
            return Judged(text, short, Verdict.UNJUDGED, where)
        match = rule.pattern.fullmatch(text)
        assert match is not None
        heard = Heard(said, match, self._device, self._names, self._addresses)
        verdict, truth = rule.claim(heard), ""
        if verdict is Verdict.UNTRUE:
            seen = dict.fromkeys("".join("01"[on] for on in m.on) for m in heard.moments)
            truth = f"torque was {', '.join(seen)}; state {said.about.get('state')}"
        return Judged(text, short, verdict, where, truth)

    def _sentences(self, text: str) -> list[str]:
        """Several troubles may stand in one line."""
        for face in self._faces:
            text = text.replace(face, "FACE")
        first, *others = _NEXT_TROUBLE.split(text)
        kind = _KIND.match(text)
        return [first, *(f"{kind[0] if kind else ''}{each}" for each in others)]

    def _rule(self, text: str) -> Rule | None:
        if text not in self._known:
            self._known[text] = next((r for r in self._rules if r.pattern.fullmatch(text)), None)
        return self._known[text]


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


def statement_figures(judged: Sequence[Judged]) -> dict[str, Any]:
    """The figures: how many claimed something, how many different ones, how many were untrue.

    unknown_share: of all that could have claimed. silent: that say nothing of torque, by a rule.
    """
    by = Counter(each.verdict for each in judged)
    claims = [j for j in judged if j.verdict in (Verdict.TRUE, Verdict.UNTRUE, Verdict.UNKNOWN)]
    return {
        "statements": len(claims),
        "templates": len({each.template for each in claims}),
        "untrue": by[Verdict.UNTRUE],
        "unjudged": by[Verdict.UNJUDGED],
        "unknown_share": by[Verdict.UNKNOWN] / len(claims) if claims else 0.0,
        "says_nothing": by[Verdict.SILENT],
    }
