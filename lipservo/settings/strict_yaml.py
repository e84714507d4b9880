"""Strict YAML for settings: one mapping, no key given twice, and a clear line for each error.

Numbers are those of YAML 1.2 (https://yaml.org/spec/1.2.2/#1032-tag-resolution): `011` is 11 and
`3e2` is 300, where YAML 1.1, which PyYAML reads, has 9 and a text; and a date is a text. Errors of
pydantic are rephrased in the words of the person who wrote the file.
"""

import re
from collections.abc import Iterator
from difflib import get_close_matches
from typing import get_args

import yaml
from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from lipsync.errors import UserError, shown
from lipsync.yaml_depth import is_nested_deeper

#: Longer than any number of a setting; Python refuses to read ints of 4,300 digits.
_MOST_DIGITS = 40
#: Settings need four levels.
_DEEPEST = 20
_INT = "tag:yaml.org,2002:int"
_FLOAT = "tag:yaml.org,2002:float"
_REPLACED_TAGS = (_INT, _FLOAT, "tag:yaml.org,2002:timestamp")
_EXPECTED_KIND = {
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "finite_number": "a finite number",
    "string_type": "text",
    "tuple_type": "a list: put it in [ ]",
    "mapping_type": "settings of its own (`key: value` lines)",
    "dict_type": "settings of its own (`key: value` lines)",
    "model_type": "settings of its own (`key: value` lines)",
    "invalid_key": "a key of text",
}


#: More would hide the first.
_MOST_LINES = 20
_LONGEST_KEY = 60


class SettingsError(UserError):
    """Settings that cannot be used; one line for each error: key, fault, and what is allowed."""


#: libyaml's where PyYAML has it: ten times as quick.
_SafeLoader: type[yaml.SafeLoader] = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class _Loader(_SafeLoader):  # type: ignore[misc, valid-type]  # one of two
    """PyYAML's safe loader with the numbers of YAML 1.2."""


_Loader.yaml_implicit_resolvers = {
    first: [each for each in resolvers if each[0] not in _REPLACED_TAGS]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}


def _number(loader: yaml.SafeLoader, node: yaml.ScalarNode) -> int | float:
    text = loader.construct_scalar(node)
    if node.tag == _FLOAT:
        return float(text.replace(".inf", "inf").replace(".nan", "nan"))
    return int(text, {"0x": 16, "0o": 8}.get(text[:2], 10))


_Loader.add_constructor(_INT, _number)
_Loader.add_constructor(_FLOAT, _number)
_Loader.add_implicit_resolver(
    _INT,
    re.compile(rf"^(?:[-+]?[0-9]{{1,{_MOST_DIGITS}}}|0o[0-7]{{1,20}}|0x[0-9a-fA-F]{{1,20}})$"),
    list("-+0123456789"),
)
_Loader.add_implicit_resolver(
    _FLOAT,
    re.compile(
        r"^(?:[-+]?(?:\.[0-9]+|[0-9]+\.[0-9]*|[0-9]+(?=[eE]))(?:[eE][-+]?[0-9]+)?"
        r"|[-+]?\.inf|\.nan)$"
    ),
    list("-+.0123456789"),
)


def read_mapping(text: str, file_name: str) -> dict[object, object]:
    """Parse `text` as one mapping of plain values; `file_name` begins error lines.

    Raises SettingsError if the text is empty, not YAML, nested too deep, not a mapping, or gives a
    key twice, of which PyYAML would silently keep the last.
    """
    try:
        if is_nested_deeper(text, _DEEPEST):
            raise SettingsError(f"{file_name}: nested too deep for settings")
        root = yaml.compose(text, Loader=_Loader)
        if root is None:
            raise SettingsError(f"{file_name}: is empty")
        repeated = list(_repeated_keys(root, file_name, set()))
        if repeated:
            raise SettingsError("\n".join(repeated))
        content: object = _Loader("").construct_document(root)
    except (yaml.YAMLError, ValueError) as error:
        if isinstance(error, SettingsError):
            raise
        raise SettingsError(_yaml_error_line(error, file_name)) from error
    if not isinstance(content, dict):
        raise SettingsError(f"{file_name}: must have `key: value` lines, found {_kind_of(content)}")
    return content


def _kind_of(content: object) -> str:
    if content is None:
        return "nothing"
    return "a list" if isinstance(content, list) else shown(content)


def _repeated_keys(node: yaml.Node, where: str, visited: set[int]) -> Iterator[str]:
    """Yield a line of text for each key given twice at or below `node`.

    where: file and keys that lead to the node. visited: ids of nodes seen, which ends loops of
    aliases.
    """
    if id(node) in visited:
        return
    visited.add(id(node))
    if isinstance(node, yaml.MappingNode):
        line_of: dict[str, int] = {}
        for key, value in node.value:
            if not isinstance(key, yaml.ScalarNode):
                continue
            line = key.start_mark.line + 1
            if key.value in line_of:
                yield (
                    f"{where}.{key.value}: given twice, on lines {line_of[key.value]} and {line}; "
                    "keep one"
                )
            line_of[key.value] = line
            yield from _repeated_keys(value, f"{where}.{key.value}", visited)
    elif isinstance(node, yaml.SequenceNode):
        for index, item in enumerate(node.value):
            yield from _repeated_keys(item, f"{where}.{index}", visited)


def _yaml_error_line(error: Exception, file_name: str) -> str:
    if isinstance(error, yaml.MarkedYAMLError) and error.problem_mark is not None:
        line = error.problem_mark.line + 1
        return f"{file_name}: not YAML at line {line}: {error.problem or error.context}"
    if isinstance(error, yaml.YAMLError):
        return f"{file_name}: not YAML: {' '.join(str(error).split())}"
    return f"{file_name}: not YAML: a value in it is not what its tag (`!!`) says"


def explain(error: ValidationError, schema: type[BaseModel], file_name: str) -> list[str]:
    """Return a line for each error: file and keys, what is wrong, what is allowed; 20 at most.

    schema: the model that was validated, for the names of known keys.
    """
    lines = [
        f"{_place_of_error(file_name, detail)}: {line}"
        for detail in error.errors(include_url=False)
        for line in _lines_of_error(detail, schema)
    ]
    n_more = len(lines) - _MOST_LINES
    return lines if n_more <= 0 else [*lines[:_MOST_LINES], f"{file_name}: and {n_more} more"]


def _place_of_error(file_name: str, detail: ErrorDetails) -> str:
    """Join file and keys with dots; leave out "[key]", pydantic's mark for a bad mapping key."""
    return ".".join(
        [file_name, *(str(part)[:_LONGEST_KEY] for part in detail["loc"] if part != "[key]")]
    )


def _lines_of_error(detail: ErrorDetails, schema: type[BaseModel]) -> Iterator[str]:
    """Yield the lines that explain one error of pydantic's to the author of a YAML.

    File and key are left out: `explain` adds them. schema: the model that was validated, for the
    names of known keys.
    """
    kind, value = detail["type"], detail["input"]
    if kind == "missing":
        yield "is missing"
    elif kind == "extra_forbidden":
        *path, key = detail["loc"]
        yield f"unknown setting; {_key_suggestion(str(key), _keys_at(tuple(path), schema))}"
    elif kind == "literal_error":
        allowed = detail["ctx"]["expected"].replace("'", "").replace(" or ", ", ")
        yield f"{shown(value)} is not known here; use one of {allowed}"
    elif kind == "string_pattern_mismatch":
        yield f"{shown(value)} does not have the form {detail['ctx']['pattern']}"
    elif kind == "string_too_short":
        yield "is empty"
    elif kind == "value_error":
        yield from str(detail["ctx"]["error"]).splitlines()
    elif kind in _EXPECTED_KIND:
        why = ""
        if kind == "string_type" and isinstance(value, bool):
            why = "; YAML reads on, off, yes and no as true and false: put it in quotes"
        elif kind == "string_type" and isinstance(value, int | float):
            why = "; put it in quotes"
        yield f"{shown(value)} is not {_EXPECTED_KIND[kind]}{why}"
    else:
        yield detail["msg"]


def _key_suggestion(key: str, known: list[str]) -> str:
    nearest = get_close_matches(key, known, n=1)
    return f"did you mean {nearest[0]}?" if nearest else f"known here: {', '.join(known)}"


def _keys_at(path: tuple[int | str, ...], kind: object) -> list[str]:
    """Return the keys known at `path` below `kind`, a model or a mapping or tuple of models.

    path: keys of mappings and indices of lists, as pydantic gives them for an error.
    """
    if not (isinstance(kind, type) and issubclass(kind, BaseModel)):
        # A mapping's or tuple's last type argument is that of its values; a union takes no key.
        *_, values = (each for each in get_args(kind) if each not in (..., type(None)))
        return _keys_at(path if type(None) in get_args(kind) else path[1:], values)
    if not path:
        return list(kind.model_fields)
    schema_by_name = getattr(kind, "by_name", {}).get(path[0])
    if schema_by_name is not None:  # a mapping whose values differ
        return _keys_at(path[2:], schema_by_name[path[1]])
    return _keys_at(path[1:], kind.model_fields[str(path[0])].annotation)
