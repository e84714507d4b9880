"""Classes that a base in a neighbour file completes, and attributes set after construction.

Read from the syntax alone. Types are known as far as annotations, constructor calls, the annotated
results of functions called, and `self.x` as `__init__` assigns it, tell them.
"""

import ast
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from lipservo_lab.bench.house.code_lines import sources

_FOLDERS: Final = ("calibration", "firmware_bridge", "lipservo", "lipsync", "client", "lab")
#: Bases that a class may have from anywhere: contracts, and what Python knows by its base.
_CONTRACTS: Final = {"Protocol", "ABC", "NamedTuple", "TypedDict", "Enum", "StrEnum", "IntEnum"}
_FUNCTION: Final = (ast.FunctionDef, ast.AsyncFunctionDef)
_Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(slots=True)
class ClassSource:
    """What the source says of a class: where, bases, constructor arguments, types of attributes."""

    file: str
    node: ast.ClassDef
    bases: list[str]
    arguments: set[str] = field(default_factory=set)
    setters: set[str] = field(default_factory=set)
    attributes: dict[str, str] = field(default_factory=dict)
    #: Attributes that `__init__` makes: parts, whose state is the owner's own matter.
    parts: set[str] = field(default_factory=set)


class SourceTree:
    """All modules of a checkout, with the classes and functions that they define."""

    def __init__(self, root: Path) -> None:
        self.trees = {
            path.relative_to(root).as_posix(): ast.parse(path.read_text("utf-8"))
            for folder in _FOLDERS
            for path in sources(root, folder)
        }
        self._modules = {_module(file): file for file in self.trees}
        #: Names of every module's classes, functions and imports: what each stands for.
        self._names = {file: dict(self._imports(tree)) for file, tree in self.trees.items()}
        self.classes: dict[str, ClassSource] = {}
        self._results: dict[str, tuple[str, ast.expr]] = {}
        for file, tree in self.trees.items():
            module = _module(file)
            for node in tree.body:
                if isinstance(node, ast.ClassDef | ast.FunctionDef):
                    self._names[file][node.name] = f"{module}:{node.name}"
                if isinstance(node, ast.FunctionDef) and node.returns is not None:
                    self._results[f"{module}:{node.name}"] = file, node.returns
        #: Names of classes that are constructed somewhere.
        self.constructed = {
            node.func.id
            for tree in self.trees.values()
            for node in ast.walk(tree)
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
        }
        for file, tree in self.trees.items():
            for node in tree.body:
                if isinstance(node, ast.ClassDef):
                    self.classes[f"{_module(file)}:{node.name}"] = self._class(file, node)
        for each in self.classes.values():
            self._read_attributes(each)

    def typed(self, file: str, annotation: ast.expr | None) -> str | None:
        """Return the class of ours that an annotation names: `X`, `"X"` or `X | None`."""
        match annotation:
            case ast.Constant(value=str() as text):
                try:
                    return self.typed(file, ast.parse(text, mode="eval").body)
                except SyntaxError:
                    return None
            case ast.BinOp(left=left, right=right):
                return self.typed(file, left) or self.typed(file, right)
            case ast.Name(id=name):
                found = self._names[file].get(name, "")
                return found if found in self.classes else None
            case ast.Attribute(value=ast.Name(id=module), attr=name):
                imported = self._names[file].get(module, "").replace(":", ".")
                found = f"{imported}:{name}"
                return found if found in self.classes else None
        return None

    def value_type(self, file: str, value: ast.expr | None, known: dict[str, str]) -> str | None:
        """Return the class of what an expression yields; known: of names and `self.x`."""
        match value:
            case ast.Call(func=function):
                made = self.typed(file, function)
                if made is not None:
                    return made
                if isinstance(function, ast.Name):
                    name = self._names[file].get(function.id, "")
                    if name in self._results:
                        return self.typed(*self._results[name])
                return None
            case ast.Name(id=name):
                return known.get(name)
            case ast.Attribute(value=inner, attr=name):
                owner = self.value_type(file, inner, known)
                return self.attribute_type(owner, name) if owner else None
        return None

    def attribute_type(self, owner: str, name: str) -> str | None:
        """Return the class of an attribute of a class of ours, or of its bases."""
        found = self.classes[owner].attributes.get(name)
        for base in self.classes[owner].bases:
            if found is None and base in self.classes:
                found = self.attribute_type(base, name)
        return found

    def constructor(self, owner: str) -> set[str]:
        """Return the arguments of a constructor, and properties that can be set."""
        found = self.classes[owner].arguments | self.classes[owner].setters
        for base in self.classes[owner].bases:
            if base in self.classes:
                found |= self.constructor(base)
        return found

    def _imports(self, tree: ast.Module) -> Iterator[tuple[str, str]]:
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module:
                for alias in node.names:
                    yield alias.asname or alias.name, f"{node.module}:{alias.name}"

    def _class(self, file: str, node: ast.ClassDef) -> ClassSource:
        names = self._names[file]
        bases = [
            names.get(base.id, base.id)
            for base in (b.value if isinstance(b, ast.Subscript) else b for b in node.bases)
            if isinstance(base, ast.Name)
        ]
        found = ClassSource(file, node, bases)
        is_record = any("dataclass" in ast.unparse(each) for each in node.decorator_list)
        for part in node.body:
            if isinstance(part, ast.AnnAssign) and isinstance(part.target, ast.Name) and is_record:
                found.arguments.add(part.target.id)
            if isinstance(part, _FUNCTION):
                if part.name == "__init__":
                    given = part.args
                    found.arguments |= {a.arg for a in (*given.args, *given.kwonlyargs)}
                if any(ast.unparse(each).endswith(".setter") for each in part.decorator_list):
                    found.setters.add(part.name)
        return found

    def _read_attributes(self, found: ClassSource) -> None:
        for part in found.node.body:
            if isinstance(part, ast.AnnAssign) and isinstance(part.target, ast.Name):
                self._keep(found, part.target.id, self.typed(found.file, part.annotation))
            if isinstance(part, ast.FunctionDef) and part.name == "__init__":
                known = self.parameters(found.file, part)
                for node in ast.walk(part):
                    if isinstance(node, ast.Assign | ast.AnnAssign):
                        target = node.targets[0] if isinstance(node, ast.Assign) else node.target
                        name = _self_attribute(target)
                        if not name:
                            continue
                        if isinstance(node.value, ast.Call):
                            found.parts.add(name)
                        kind = self.value_type(found.file, node.value, known)
                        if isinstance(node, ast.AnnAssign):
                            kind = self.typed(found.file, node.annotation) or kind
                        self._keep(found, name, kind)
            if isinstance(part, ast.FunctionDef) and any(
                ast.unparse(each) == "property" for each in part.decorator_list
            ):
                self._keep(found, part.name, self.typed(found.file, part.returns))

    def _keep(self, found: ClassSource, name: str, kind: str | None) -> None:
        if kind is not None:
            found.attributes.setdefault(name, kind)

    def parameters(
        self, file: str, function: ast.FunctionDef | ast.AsyncFunctionDef
    ) -> dict[str, str]:
        """Return the classes of the parameters of a function, by name."""
        given = function.args
        kinds = {
            each.arg: self.typed(file, each.annotation)
            for each in (*given.posonlyargs, *given.args, *given.kwonlyargs)
        }
        return {name: kind for name, kind in kinds.items() if kind is not None}


def mixin_bases(tree: SourceTree) -> list[str]:
    """List classes as `file:line` that have their other half in a neighbour file.

    That is, a base of ours that no other class has and no code constructs, and that is no contract.
    """
    heirs: defaultdict[str, list[ClassSource]] = defaultdict(list)
    for each in tree.classes.values():
        for base in each.bases:
            if base in tree.classes:
                heirs[base].append(each)
    return sorted(
        f"{heir.file}:{heir.node.lineno} {heir.node.name}({tree.classes[base].node.name})"
        for base, (heir, *others) in heirs.items()
        if not others
        and tree.classes[base].node.name not in tree.constructed
        and heir.file != tree.classes[base].file
        and Path(heir.file).parent == Path(tree.classes[base].file).parent
        and not _is_contract(tree, base)
    )


def late_attributes(tree: SourceTree) -> list[str]:
    """List assignments as `file:line` of attributes that the constructor takes no argument for.

    Of objects of ours, from outside of their class.
    """
    found = set()
    for file, module in tree.trees.items():
        for owner, function in _functions(module):
            known = tree.parameters(file, function)
            inside = f"{_module(file)}:{owner}"
            if owner and inside in tree.classes:
                known.setdefault("self", inside)
            for node in ast.walk(function):
                targets = node.targets if isinstance(node, ast.Assign) else []
                if isinstance(node, ast.AnnAssign | ast.AugAssign):
                    targets = [node.target]
                for target in targets:
                    value = getattr(node, "value", None)
                    if isinstance(target, ast.Name):
                        kind = tree.value_type(file, value, known)
                        if isinstance(node, ast.AnnAssign):
                            kind = tree.typed(file, node.annotation) or kind
                        if kind is not None:
                            known[target.id] = kind
                    elif isinstance(target, ast.Attribute) and not _self_attribute(target):
                        owned = tree.classes[inside].parts if inside in tree.classes else set()
                        if _self_attribute(target.value) in owned:
                            continue
                        kind = tree.value_type(file, target.value, known)
                        if kind and kind != inside and target.attr not in tree.constructor(kind):
                            found.add(f"{file}:{target.lineno} {ast.unparse(target)}")
    return sorted(found)


def _is_contract(tree: SourceTree, name: str) -> bool:
    """Whether a class is a protocol, an exception, or of a library's own kind."""
    bases = tree.classes[name].bases
    return any(
        base.rpartition(":")[2] in _CONTRACTS
        or base.endswith(("Error", "Exception", "Group"))
        or (base in tree.classes and _is_contract(tree, base))
        for base in bases
    )


def _functions(module: ast.Module) -> Iterator[tuple[str, _Function]]:
    """Yield every function of a module and every method, with the name of its class."""
    for node in module.body:
        if isinstance(node, _FUNCTION):
            yield "", node
        elif isinstance(node, ast.ClassDef):
            for part in node.body:
                if isinstance(part, _FUNCTION):
                    yield node.name, part


def _self_attribute(target: ast.expr) -> str:
    """Return the x of `self.x`; empty for anything else."""
    match target:
        case ast.Attribute(value=ast.Name(id="self" | "cls"), attr=name):
            return name
    return ""


def _module(file: str) -> str:
    parts = list(Path(file).with_suffix("").parts)
    if parts[0] in ("client", "lab"):
        del parts[0]
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
