"""A pydantic error in the words of the person who wrote the YAML."""

from collections.abc import Iterator
from difflib import get_close_matches
from typing import get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from lipsync.errors import shown

_WANTED = {
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "finite_number": "a finite number",
    "string_type": "text",
    "mapping_type": "settings of its own (`key: value` lines)",
    "dict_type": "settings of its own (`key: value` lines)",
    "model_type": "settings of its own (`key: value` lines)",
    "invalid_key": "a key of text",
}


#: More would hide the first.
_MOST_LINES = 20
_LONGEST_KEY = 60


def explain(error: ValidationError, schema: type[BaseModel], file_name: str) -> list[str]:
    """Say each error in one line: path from the file down, what is wrong, what is allowed."""
    lines = [
        f"{_path(file_name, detail)}: {line}"
        for detail in error.errors(include_url=False)
        for line in _lines(detail, schema)
    ]
    n_more = len(lines) - _MOST_LINES
    return lines if n_more <= 0 else [*lines[:_MOST_LINES], f"{file_name}: and {n_more} more"]


def _path(file_name: str, detail: ErrorDetails) -> str:
    """Join file and keys with dots; pydantic marks a bad mapping key by a last part "[key]"."""
    return ".".join(
        [file_name, *(str(part)[:_LONGEST_KEY] for part in detail["loc"] if part != "[key]")]
    )


def _lines(detail: ErrorDetails, schema: type[BaseModel]) -> Iterator[str]:
    kind, value = detail["type"], detail["input"]
    if kind == "missing":
        yield "is missing"
    elif kind == "extra_forbidden":
        *path, key = detail["loc"]
        yield f"unknown setting; {_nearest(str(key), _keys_at(tuple(path), schema))}"
    elif kind == "literal_error":
        allowed = detail["ctx"]["expected"].replace("'", "").replace(" or ", ", ")
        yield f"{shown(value)} is not known here; use one of {allowed}"
    elif kind == "string_pattern_mismatch":
        yield f"{shown(value)} does not have the form {detail['ctx']['pattern']}"
    elif kind == "string_too_short":
        yield "is empty"
    elif kind == "value_error":
        yield from str(detail["ctx"]["error"]).splitlines()
    elif kind in _WANTED:
        yield f"{shown(value)} is not {_WANTED[kind]}"
    else:
        yield detail["msg"]


def _nearest(key: str, known: list[str]) -> str:
    nearest = get_close_matches(key, known, n=1)
    return f"did you mean {nearest[0]}?" if nearest else f"known here: {', '.join(known)}"


def _keys_at(path: tuple[int | str, ...], kind: object) -> list[str]:
    """List the settings known at `path` below `kind`: a model, or a mapping or tuple of them."""
    if not (isinstance(kind, type) and issubclass(kind, BaseModel)):
        return _keys_at(path[1:], next(each for each in get_args(kind)[::-1] if each is not ...))
    if not path:
        return list(kind.model_fields)
    return _keys_at(path[1:], kind.model_fields[str(path[0])].annotation)
