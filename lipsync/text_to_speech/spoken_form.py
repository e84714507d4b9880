"""The words that a person would read out of a text as language models write it.

Markdown is read by markdown-it-py (docs/decisions/labels-and-text.md). Left out are marks,
addresses behind links, pictures, code blocks, formulas, smileys, footnotes, stage directions in
brackets, text struck out, and a model's thoughts. Kept are the words between SSML tags and the
hosts of bare links; in English, times, money, dates and ranges are written as they are read out.
"""

import html
import re
import unicodedata
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from markdown_it import MarkdownIt

#: A text of letters, spaces and plain punctuation alone is not changed.
_PLAIN: Final = re.compile(r"(?:[^\W\d_]|[ \n.,!?'\"\u2019]|(?<=\w)[-;:](?=[\w ]))*\Z")
#: Tags that are left out with the text between them.
_SILENT_TAGS: Final = "think|thinking|reasoning|scratchpad|script|style|tool_call|function_call"
_Rule = tuple[re.Pattern[str], str | Callable[[re.Match[str]], str]]


def _rules(*rules: tuple[str, str | Callable[[re.Match[str]], str]]) -> tuple[_Rule, ...]:
    flags = re.MULTILINE | re.DOTALL
    return tuple((re.compile(pattern, flags), by) for pattern, by in rules)


#: Applied before Markdown is parsed, which would take these apart.
_MARKUP: Final = _rules(
    (rf"<({_SILENT_TAGS})\b[^>]*>.*?(?:</\1>|\Z)", " "),
    (r"<!--.*?(?:-->|\Z)", " "),
    (r"\A---\n(?:[A-Za-z_][\w-]*:[^\n]*\n|[ \t-]+[^\n]*\n)+?---\n", ""),
    (r"<sub\b[^<>]*\balias=[\"']([^\"']*)[\"'][^<>]*>[^<]*</sub>", r"\1"),
    (
        r"<say-as\b[^<>]*\"(?:characters|spell-out|verbatim)\"[^<>]*>([^<]*)</say-as>",
        lambda found: " ".join(found[1]),
    ),
    (r"(?<=\w)[ \t]*<break\b[^>]*>[ \t]*(?=\w)", "; "),
    (r"</?[A-Za-z][\w:-]*(?:\s[^<>]*)?/?>", " "),
    # Formulas; between two prices there is none.
    (
        r"\$\$.*?\$\$|\\\[(?:(?!\\\[).)*?\\\]|\\\((?:(?!\\\().)*?\\\)"
        r"|\$(?!\s)(?=[^$\n]*[\\^_{}=])[^$\n]*(?<!\s)\$(?!\d)",
        " ",
    ),
    (r"\$ (?!\d)(?=[^$\n]*[\\^_{}=])[^$\n]* \$(?!\s?\d)", " "),
    (r"(?<=\d)\*(?=\d)", "\u00d7"),
    (r"【[^】]*】", " "),
    (r"^\[\^[^\]]+\]:.*?$", " "),
    (r"^([^\S\n]*(?:[-*+]|\d+[.)])\s+)\[[ xX]\]\s", r"\1"),
    (r"\[\^[^\[\]\s]+\]|(?<!\])(?:\[\d+(?:\s?[,\u2013-]\s?\d+)*\])+(?![(:])", " "),
    (r"\[[a-z][a-z ,'\u2019-]*\](?![(\[:])", " "),
    (
        r"(?<![\w*])(?:[:;=]['\u2019]?-?[)(DPpOo3/\\*\]\[]+|[xX]D|<3+|\^_?\^|-_-|T_T|[oO]_[oO])(?!\w)",
        " ",
    ),
    (r"¯\\+_\(ツ\)_/+¯", " "),
    (r"(?<!\w):[a-z][a-z0-9_+-]+:(?!\w)", " "),
    (r"^[^\S\n]*[•‣◦▪●○\u2013—]\s+", "- "),
)
_LINKS: Final = _rules(
    (
        r"(?:mailto:|(?<![\w.+-]))([\w.+-]+)@([\w-]+(?:\.[\w-]+)+)",
        lambda m: f"{m[1]} at {_host(m[2])}",
    ),
    (
        r"\b(?:(?:https?|ftp|wss?)://(?:www\.)?|www\.)([\w.-]+\w)(?::\d+)?"
        r"(?:[/?#](?:[^\s)>\]]*[^\s)>\].,;:!?])?)?",
        lambda m: _host(m[1]),
    ),
)
#: A number of two digits, or a year.
_FEW: Final = r"\d{1,2}|1\d{3}|20\d\d"
#: A number with a decimal point or commas, or of two digits.
_SOME: Final = r"\d[\d,]*\.\d+|\d{1,3}(?:,\d{3})+|\d{1,2}"
_FRACTIONS: Final = {"1/2": "a half", "1/4": "a quarter", "3/4": "three quarters"}
#: How figures are read out in English.
_ENGLISH: Final = _rules(
    (r"\b(\d{4})-(0[1-9]|1[0-2])-([0-2]\d|3[01])\b", lambda m: _date(m[1], m[2], m[3])),
    (
        r"([$€£])\s?(\d[\d,]*)(?:\.(\d\d)(?!\d)|(\.\d+))?"
        r"(\s(?:thousand|million|billion|trillion)\b|[kKmMbBtT]\b|(?:mn|bn|tn)\b)?",
        lambda m: _money(m),
    ),
    (
        r"\b(\d{1,2}(?::[0-5]\d)?(?:\s?[AaPp]\.?[Mm]\b\.?)?)\s?[-\u2013]\s?"
        r"(?=\d{1,2}(?::[0-5]\d(?!\d|:\d)|\s?[AaPp]\.?[Mm]\b))",
        r"\1 to ",
    ),
    (r"\b([01]?\d|2[0-3]):([0-5]\d)(?!\d|:\d)(?:\s?([AaPp])\.?[Mm]\b\.?)?", lambda m: _clock(m)),
    (r"\b(\d{1,2})\s?([AaPp])\.?[Mm]\b", lambda m: f"{m[1]} {m[2].upper()} M"),
    (r"\b(dollars?|euros?|pounds?|cents?)[-\u2013](?=\d)", r"\1 to "),
    (rf"(?<![\w.,-])({_SOME})-({_SOME})(?![\d-]|[.,]\d|\s?=\s?-?\d)", r"\1 to \2"),
    (rf"(?<![\d.-])({_FEW})\s?[-\u2013]\s?({_FEW})(?![\d-]|\.\d|\s?[-+=]\s?\d)", r"\1 to \2"),
    (r"(?<=\d)\s?\u2013\s?(?=\d)", " to "),
    (r"(?<=\d)-(?=\d)", " "),
    (r"(?<![\d/])(1/2|1/4|3/4)(?![\d/])", lambda m: _FRACTIONS[m[1]]),
    (r"(?<=\d)\s?[*\u00d7]\s?(?=\d)", " times "),
    (r"(?<!\S)[~≈]\s?(?=\d)", "about "),
    (r"(?<=\S)\s?&\s?(?=\S)", " and "),
    (r"\b([A-G])#(?!\w)", r"\1 sharp"),
    (r"(?<!\w)#(?=\d)", "number "),
)
_LEFTOVERS: Final = _rules(
    (r"(?<=\d)\s?[*\u00d7]\s?(?=\d)", " \u00d7 "),
    (r"(?<!\S)[@#](?=\w)", ""),
    (r"(?<=\w)/(?=\w)", " "),
    (r"[-=]{2,}>?|=>|->|<-|[←-⇿]", " "),
    (r"[*_`~#|\\^{}<>•]+", " "),
    (r"(?<!\w)=+(?!\s?\w)|\(\s*\)|\]\[[^\]]*\]|[\[\]]", " "),
    (r"[ \t]+", " "),
    (r" (?=[,.;:!?)])", ""),
    (r"(?<=[(]) ", ""),
    (r"(?<![,;:])[,;:]+(?=[.!?])|^[ ,.;:)]+(?=\s|$)| +$|^ +", ""),
    (r"\n{3,}", "\n\n"),
)
_MONTHS: Final = (
    *("January", "February", "March", "April", "May", "June", "July", "August", "September"),
    *("October", "November", "December"),
)
_CURRENCY: Final = {"$": "dollar", "€": "euro", "£": "pound"}
#: By the first letter of what follows an amount.
_SCALE: Final = {"k": "thousand", "m": "million", "b": "billion", "t": "trillion"}
#: Symbols that voices read out; all others in the categories below are pictures, left out.
_READ_OUT: Final = "°"
_PICTURES: Final = ("So", "Sk", "Cf", "Co")


def spoken_form(text: str, language: str = "en-us") -> str:
    """Return the words of `text` as a person would read them out; "" where no one would say any.

    A text of plain words and punctuation is returned as it is. A result given to the function again
    is returned unchanged, unless it happens to contain marks of Markdown, SSML or the like.
    """
    if _PLAIN.match(text):
        return text
    result = _apply_rules(html.unescape(text), _MARKUP)
    result = "\n\n".join(_block_texts(result))
    result = "".join(
        " " if unicodedata.category(letter) in _PICTURES and letter not in _READ_OUT else letter
        for letter in result
    )
    result = _apply_rules(result, _LINKS)
    if language.partition("-")[0] in ("en", ""):
        result = _apply_rules(result, _ENGLISH)
    result = _apply_rules(result, _LEFTOVERS).strip()
    return result if any(map(str.isalnum, result)) else ""


def _apply_rules(text: str, rules: Sequence[_Rule]) -> str:
    """Return the text after the substitution of each rule, in order."""
    for pattern, replacement in rules:
        text = pattern.sub(replacement, text)
    return text


@cache
def _markdown() -> "MarkdownIt":
    """Return the parser of Markdown with tables and struck out text, without HTML."""
    from markdown_it import MarkdownIt

    # Indented text is no code here: people and models indent speech, too.
    return (
        MarkdownIt("commonmark", {"html": False}).enable(["table", "strikethrough"]).disable("code")
    )


def _block_texts(text: str) -> Iterator[str]:
    """Yield the words of each paragraph, heading, list item and row of a table."""
    cells: list[str] | None = None
    number = ""
    for token in _markdown().parse(text):
        if token.type == "tr_open":
            cells = []
        elif token.type == "tr_close" and cells is not None:
            yield ", ".join(filter(None, cells))
            cells = None
        elif token.type == "list_item_open" and len(token.info) > 2:
            number = f"{token.info}. "  # "1984. A good year." is no list
        elif token.type == "inline":
            words = number + "".join(_inline_texts(token.children or ()))
            number = ""
            if cells is None:
                yield words
            else:
                cells.append(words.strip())


def _inline_texts(tokens: Sequence[Any]) -> Iterator[str]:
    """Yield the text of a paragraph's markdown-it tokens, without what is struck out."""
    n_struck = 0
    for token in tokens:
        n_struck += token.nesting if token.type in ("s_open", "s_close") else 0
        if n_struck:
            continue
        if token.type in ("text", "code_inline"):
            yield token.content
        elif token.type in ("softbreak", "hardbreak"):
            yield "\n"


def _host(name: str) -> str:
    """Return an internet host in words: `example.com` as `example dot com`."""
    return name.strip(".").replace(".", " dot ")


def _date(year: str, month: str, day: str) -> str:
    """Return an ISO date in words: 2026-01-31 as `January 31, 2026`."""
    return f"{_MONTHS[int(month) - 1]} {int(day)}, {year}"


def _money(found: re.Match[str]) -> str:
    """Return a matched amount with its currency in words: `$5.50` as `5 dollars 50 cents`.

    With `million` and the like, or not two decimals, it stays a number: `$1.5` as `1.5 dollars`.
    """
    sign, whole, cents, long_fraction, scale = found.groups()
    unit = _CURRENCY[sign]
    number = whole.rstrip(",") + (long_fraction or "")
    if scale:
        word = scale.strip() if len(scale) > 2 else _SCALE[scale[0].lower()]
        return f"{number}{'.' + cents if cents else ''} {word} {unit}s"
    plural = "" if number == "1" else "s"
    comma = "," if whole.endswith(",") else ""
    cents_in_words = f" {int(cents)} cent{'s' * (cents != '01')}" if cents and int(cents) else ""
    return f"{number} {unit}{plural}{cents_in_words}{comma}"


def _clock(found: re.Match[str]) -> str:
    """Return a matched time of day in words: `9:05` as `9 oh 5`, `9:00` as `9 o'clock`."""
    hour, minute, am_or_pm = found.groups()
    suffix = f" {am_or_pm.upper()} M" if am_or_pm else ""
    if minute == "00":
        return f"{int(hour)}" + (suffix or " o'clock")
    return f"{int(hour)} {'oh ' if minute[0] == '0' else ''}{int(minute)}{suffix}"
