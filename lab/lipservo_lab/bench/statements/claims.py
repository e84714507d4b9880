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
    """A statement: requested at `since_s`, received at `until_s`, monotonic seconds.

    text: begins with its kind, as in `status servos.jaw: driven`. about: the JSON object that it is
    part of; for a line of output: `began_s`, when its process was started.
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
    """A statement with the match of its rule, and the log to compare it with.

    names, addresses: of the face's servos, in the order of the log.
    """

    statement: Statement
    match: re.Match[str]
    device: LoggedDevice
    names: tuple[str, ...]
    addresses: tuple[int, ...]

    @property
    def records(self) -> list[Moment]:
        """Return the log's records from shortly before the statement's request to its arrival."""
        statement = self.statement
        return self.device.during(statement.since_s - OLD_S, statement.until_s)

    def servos(self, group: str) -> list[int]:
        """Return the indices of the servos that a claim is about.

        group: "all", or the name of the pattern's group with their names or addresses; of several
        names with `|` between, the first that has matched.
        """
        if group == "all":
            return list(range(len(self.names)))
        named_text = next(filter(None, (self.match[each] for each in group.split("|"))))
        words = re.findall(r"[\w]+", named_text)
        named = [n for n, name in enumerate(self.names) if name in words]
        if named:
            return named
        addresses = [int(each) for each in words if each.isdigit()]
        return [n for n, address in enumerate(self.addresses) if address in addresses]


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
    """The claim that servos have torque, or have none.

    who: "all"; "any": at least one servo has torque, whatever `on`; or the pattern's group, see
    `Heard.servos`.
    """

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
    """The claim that at least so many servos as the pattern's group `count` says are on, or off."""

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
    """The claim that exactly so many servos are on, or off, as the pattern's group `count` says.

    If the pattern has a group `unknown`, up to so many more.
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
    """Several claims of one sentence; claims whose group has not matched are left out."""

    claims: tuple[Claim, ...]

    def __init__(self, *claims: Claim) -> None:
        object.__setattr__(self, "claims", claims)

    def __call__(self, heard: Heard) -> Verdict:
        """Judge all claims of a sentence: untrue if one of them is, else as the first of them."""
        named = heard.match.groupdict()
        found = [each(heard) for each in self.claims if named.get(getattr(each, "who", ""), "-")]
        return Verdict.UNTRUE if Verdict.UNTRUE in found else found[0]


@dataclass(frozen=True, slots=True)
class WasOn:
    """The claim that servos have had torque, or pulses, since the process that says so began."""

    who: str

    def __call__(self, heard: Heard) -> Verdict:
        """Judge whether each of the servos had torque at some moment since the process began."""
        statement = heard.statement
        began_s = float(statement.about.get("began_s", statement.since_s))
        records = heard.device.during(began_s, statement.until_s)
        servos = heard.servos(self.who)
        return _verdict(holds=all(any(each.on[n] for each in records) for n in servos))


def limp_state(heard: Heard) -> Verdict:
    """Judge a state that means limp, except for servos of which the same status says otherwise.

    Unknown if the log disagrees, but the status says that torque is not known.
    """
    status = heard.statement.about
    doubted = [each["name"] for each in status.get("health", ()) if each["torque_on"] is not False]
    doubted += (status.get("stop_report") or {}).get("unconfirmed", ())
    limp_indices = [n for n, name in enumerate(heard.names) if name not in doubted]
    if any(not any(each.on[n] for n in limp_indices) for each in heard.records):
        return Verdict.TRUE
    return Verdict.UNKNOWN if status.get("torque_on") is None else Verdict.UNTRUE


def sent_pulse(heard: Heard) -> Verdict:
    """Judge `sent_us` of a servo: true if the servo gets about this pulse, or got it last."""
    (index,), sent_us = heard.servos("who"), float(heard.match["us"])
    # A pulse that is approached slowly may be reached a little after the statement.
    later = heard.device.during(heard.statement.until_s, heard.statement.until_s + _RAMP_S)
    for record in (*heard.records, *later):
        if record.on[index] and abs(record.pulses_us[index] - sent_us) <= _PULSE_US:
            return Verdict.TRUE
    if any(record.on[index] for record in heard.records):
        return Verdict.UNTRUE
    # No pulse now: the statement then means the last one that was sent.
    before = heard.device.during(0.0, heard.statement.until_s)
    last = next((record for record in reversed(before) if record.on[index]), None)
    return _verdict(holds=last is not None and abs(last.pulses_us[index] - sent_us) <= _PULSE_US)


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
    """Counts of checked statements.

    verdicts: by verdict. templates: those of statements that claimed something, see `template`.
    listed: for what was untrue or unjudged, by (verdict, template, bus and scene): how often it was
    made, and an example with what the log showed.
    """

    verdicts: Counter[Verdict] = field(default_factory=Counter)
    templates: set[str] = field(default_factory=set)
    listed: dict[tuple[Verdict, str, str], tuple[int, str]] = field(default_factory=dict)

    def add(self, verdict: Verdict, template_text: str, where: str = "", example: str = "") -> None:
        """Count one statement. where: its bus and scene. example: its text, for the report."""
        self.verdicts[verdict] += 1
        if verdict in _CLAIMS:
            self.templates.add(template_text)
        if verdict in (Verdict.UNTRUE, Verdict.UNJUDGED):
            n_before, first = self.listed.get((verdict, template_text, where), (0, example))
            self.listed[verdict, template_text, where] = n_before + 1, first

    def join(self, other: "Tally") -> None:
        """Add the counts of another tally to this one."""
        self.verdicts += other.verdicts
        self.templates |= other.templates
        for key, (n, example) in other.listed.items():
            n_mine, first = self.listed.get(key, (0, example))
            self.listed[key] = n_mine + n, first

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
    """Judges statements by a table of rules, against the log of one robot's servos."""

    def __init__(
        self, rules: Sequence[Rule], device: LoggedDevice, joints: Sequence[Joint], face: str
    ) -> None:
        """rules: the first that matches counts. joints: in the order of the log. face: its name."""
        self._rules, self._device = tuple(rules), device
        self._names = tuple(each.name for each in joints)
        self._addresses = tuple(each.servo_id for each in joints)
        self._faces = tuple(dict.fromkeys((face, face.replace(" ", "_"), face.replace(" ", "-"))))
        self._silent: set[str] = set()

    def judge(self, statements: Iterable[Statement], where: str = "") -> Tally:
        """Judge each sentence of the statements; return the counts. where: bus and scene."""
        tally = Tally()
        for statement in statements:
            key = statement.text.partition(": ")[0]
            if key in self._silent:  # whatever the number
                tally.verdicts[Verdict.SILENT] += 1
                continue
            for text in self._split_sentences(statement.text):
                self._judge_sentence(statement, text, where, tally)
        return tally

    def _judge_sentence(self, statement: Statement, text: str, where: str, tally: Tally) -> None:
        """Add to `tally` what the first matching rule makes of one sentence.

        Without a rule the sentence counts as `Verdict.UNJUDGED`. For an untrue one, the torque that
        was logged meanwhile is appended to the example.
        """
        template_text = template(text, self._names)
        matches = ((rule, rule.pattern.fullmatch(text)) for rule in self._rules)
        rule, match = next(((r, m) for r, m in matches if m is not None), (None, None))
        if rule is None or match is None:
            tally.add(Verdict.UNJUDGED, template_text, where, text)
            return
        heard = Heard(statement, match, self._device, self._names, self._addresses)
        verdict, truth = rule.claim(heard), ""
        if verdict is Verdict.SILENT and text.startswith("status ") and rule.any_value:
            self._silent.add(text.partition(": ")[0])
        if verdict is Verdict.UNTRUE:
            logged = dict.fromkeys("".join("01"[on] for on in m.on) for m in heard.records)
            truth = f" [torque was {', '.join(logged)}; state {statement.about.get('state')}]"
        tally.add(verdict, template_text, where, f"{text}{truth}")

    def _split_sentences(self, text: str) -> list[str]:
        """Return the sentences of a line: each of several troubles with the line's kind before it.

        The face's name is replaced by FACE.
        """
        for face in self._faces:
            text = text.replace(face, "FACE")
        first, *further = _NEXT_TROUBLE.split(text)
        prefix = _KIND.match(text)
        return [first, *(f"{prefix[0] if prefix else ''}{each}" for each in further)]


def template(text: str, names: Iterable[str]) -> str:
    """Return a sentence with placeholders for numbers, servos' names and paths.

    Sentences that differ only in these count as one. Exit statuses are kept.
    """
    text = re.sub(r"(?<![\w.])/[^\s:,;]+", "PATH", text)
    for name in sorted(names, key=len, reverse=True):
        text = re.sub(rf"\b{re.escape(name)}\b", "NAME", text)
    text = re.sub(r"NAME(, NAME)+", "NAMES", text)
    if text.startswith("exit "):
        return text
    return re.sub(r"\d+(\.\d+)?([eE][-+]?\d+)?", "N", text)
