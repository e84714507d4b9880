"""A check of how deep a YAML text is nested, before anything is built of it.

PyYAML recurses on deep YAML: its own reader ends in a RecursionError after seconds of work,
libyaml's crashes the whole program.
"""

import yaml

#: libyaml's events where PyYAML has them: some hundred times quicker.
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def is_nested_deeper(text: str, levels: int) -> bool:
    """Return whether lists and mappings are nested in one another more than `levels` times.

    Raises yaml.YAMLError if the text proves to be no YAML before such a depth is found.
    """
    depth = 0
    for event in yaml.parse(text, Loader=_LOADER):
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        if depth > levels:
            return True
    return False
