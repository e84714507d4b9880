"""The packages as source: modules, what each imports, and which folder it lies in."""

import ast
from functools import cache
from pathlib import Path

from places import ROOT

#: The packages, and which of the others each may import.
MAY_IMPORT = {
    "lipsync": {"lipservo_client"},
    "firmware_bridge": set(),
    "calibration": {"lipsync"},
    "lipservo_client": set(),
    "lipservo": {"lipsync", "calibration", "firmware_bridge", "lipservo_client"},
    "lipservo_lab": {"lipsync", "calibration", "firmware_bridge", "lipservo_client", "lipservo"},
}
#: Where each package lies, from the root: those of the wheel in the root itself.
FOLDER_OF = {name: name for name in MAY_IMPORT} | {
    "lipservo_client": "client/lipservo_client",
    "lipservo_lab": "lab/lipservo_lab",
}


def _module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    if parts[0] in ("client", "lab"):
        parts = parts[1:]
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


#: Every module, a package's own `__init__` among them, and its file.
MODULES = {
    _module_name(path): path
    for name in MAY_IMPORT
    for path in (ROOT / FOLDER_OF[name]).rglob("*.py")
}


@cache
def imported(module: str) -> frozenset[str]:
    """Every module that `module` imports, at its top or inside a function, by its full name."""
    found = set()
    for node in ast.walk(ast.parse(MODULES[module].read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}: relative import on line {node.lineno}"
            submodules = {f"{node.module}.{alias.name}" for alias in node.names} & set(MODULES)
            found |= submodules or {node.module}
    return frozenset(found)


def folder(module: str) -> str:
    """The package that a module's file lies in: a package's `__init__` lies in the package."""
    return module if MODULES[module].name == "__init__.py" else module.rpartition(".")[0]


def imports_between_folders() -> dict[str, dict[str, tuple[str, str]]]:
    """For each folder the others that it imports from, each with one (importing, imported) pair.

    A folder and the folder above it are two.
    """
    graph: dict[str, dict[str, tuple[str, str]]] = {folder(module): {} for module in MODULES}
    for module in sorted(MODULES):
        for other in sorted(imported(module) & set(MODULES)):
            if folder(other) != folder(module):
                graph[folder(module)].setdefault(folder(other), (module, other))
    return graph
