"""YAML for humans who mistype: a mapping or one clear line, and no key given twice."""

from collections.abc import Iterator

import yaml

from lipsync.errors import UserError


class SettingsError(UserError):
    """Settings that cannot be used; one line for each mistake: where, what, what is allowed."""


def read_mapping(text: str, file_name: str) -> dict[object, object]:
    """Parse `text`, which came from `file_name`, as one mapping of plain values.

    Raises SettingsError when it is empty, not YAML, not a mapping, or gives a key twice: PyYAML
    would silently keep the last one.
    """
    try:
        root = yaml.compose(text, Loader=yaml.SafeLoader)
        if root is None:
            raise SettingsError(f"{file_name}: is empty")
        repeated = list(_repeated_keys(root, file_name, set()))
        if repeated:
            raise SettingsError("\n".join(repeated))
        content: object = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise SettingsError(_explain(error, file_name)) from error
    if not isinstance(content, dict):
        raise SettingsError(
            f"{file_name}: needs settings as `key: value`, found {type(content).__name__}"
        )
    return content


def _repeated_keys(node: yaml.Node, where: str, seen: set[int]) -> Iterator[str]:
    """Describe keys given twice anywhere below `node`; `seen` ends the walk on a YAML alias."""
    if id(node) in seen:
        return
    seen.add(id(node))
    if isinstance(node, yaml.MappingNode):
        lines: dict[str, int] = {}
        for key, value in node.value:
            if not isinstance(key, yaml.ScalarNode):
                continue
            line = key.start_mark.line + 1
            if key.value in lines:
                yield (
                    f"{where}.{key.value}: given twice, on lines {lines[key.value]} and {line}; "
                    "keep one"
                )
            lines[key.value] = line
            yield from _repeated_keys(value, f"{where}.{key.value}", seen)
    elif isinstance(node, yaml.SequenceNode):
        for index, item in enumerate(node.value):
            yield from _repeated_keys(item, f"{where}.{index}", seen)


def _explain(error: yaml.YAMLError, file_name: str) -> str:
    if isinstance(error, yaml.MarkedYAMLError) and error.problem_mark is not None:
        line = error.problem_mark.line + 1
        return f"{file_name}: not YAML at line {line}: {error.problem or error.context}"
    return f"{file_name}: not YAML: {' '.join(str(error).split())}"
