"""Words of source and pages: the project's former dialect, docstrings, lengths, dead links.

`dialect_names` and `dialect_docstrings` list `file:line word` for every word of `DIALECT`: as a
part of a name that is defined (`n_told`, `SentOn`), or as a word of a docstring. Tests are left
out: their names are sentences.

`array_docstrings`: of the public functions and methods that take or return an array, those whose
docstring has a NumPy section (Parameters, Returns, Yields) and names a shape or a unit.

`pages`: words of README.md and of its first sentence, words of docs/ without decisions (code blocks
count, they are read too), links and paths that lead nowhere, and figures of README.md, a number
with its unit outside code, that docs/benchmarks.md does not have. The state tables of
docs/architecture.md, made from the code, do not count.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from lipservo_lab.bench.house.code_lines import pages

FOLDERS: Final = ("calibration", "firmware_bridge", "lipservo", "lipsync", "client", "lab")
#: `take` and `look` are left out: a take of a recording and a look-ahead are terms of the field.
DIALECT: Final = re.compile(
    r"\b(?:told|said|asked|hears|took|believes|nobody|whoever|somebody|door|judged|wish|wishes"
    r"|moments|standing|met)\b"
)
#: As a whole name only: in sentences these are English.
DIALECT_NAMES: Final = frozenset({"Turns", "SentOn", "sent_on"})

_DOCUMENTED: Final = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
_FUNCTION: Final = (ast.FunctionDef, ast.AsyncFunctionDef)
_SECTION: Final = re.compile(r"^ *(?:Parameters|Returns|Yields)\n *-{3,}$", re.MULTILINE)
_SHAPE_OR_UNIT: Final = re.compile(
    r"\bshape\b|\((?:\w+|\.{3}),(?: ?(?:\w+|\.{3}),?)*\)|\b[01] (?:to|\.\.) 1\b|%|\bin s\b"
    r"|\b(?:mm|ms|us|k?Hz|deg|degC|rad|dB|mA|pixels?|samples|ticks|frames|seconds?|degrees?)\b"
)
_FIGURE: Final = re.compile(r"(?<![\w.])(\d[\d,]*(?:\.\d+)?)\s?(%|ms|mm|deg|Hz|s|MB|of \d+)(?!\w)")
#: Made from the code, and read as a reference is.
_GENERATED: Final = re.compile(
    r"<!-- state tables.*?<!-- end of the state tables -->", flags=re.DOTALL
)
_OUR_PATH: Final = re.compile(
    r"(?:calibration|client|config|docs|examples|firmware|firmware_bridge|lab|lipservo|lipsync|tests)"
    r"/[\w./-]*(?:\.\w+|/)"
)


def word_figures(root: Path) -> dict[str, Any]:
    """Return all figures of a checkout; lists are of strings that say where."""
    names: list[str] = []
    docstrings: list[str] = []
    n_arrays, bare = 0, []
    for path in _sources(root):
        file, tree = path.relative_to(root).as_posix(), ast.parse(path.read_text("utf-8"))
        names += [f"{file}:{line} {name}" for line, name in _dialect_names(tree)]
        docstrings += [f"{file}:{line} {word}" for line, word in _dialect_words(tree)]
        for function in _array_functions(tree):
            docstring = ast.get_docstring(function) or ""
            n_arrays += 1
            if not (_SECTION.search(docstring) and _SHAPE_OR_UNIT.search(docstring)):
                bare.append(f"{file}:{function.lineno} {function.name}")
    return {
        "dialect_names": names,
        "dialect_docstrings": docstrings,
        "array_functions": n_arrays,
        "array_docstrings": round(1 - len(bare) / max(n_arrays, 1), 3),
        "array_docstrings_missing": bare,
        "pages": page_figures(root),
    }


def page_figures(root: Path) -> dict[str, Any]:
    """Return the figures of README.md and docs/, as the module's docstring says."""
    readme = (root / "README.md").read_text("utf-8")
    docs = sorted((root / "docs").glob("*.md"))
    measured = (root / "docs" / "benchmarks.md").read_text("utf-8")
    known = {_figure(each) for each in _FIGURE.finditer(measured)}
    prose = re.sub(r"^```.*?^```$|`[^`]*`", "", readme, flags=re.MULTILINE | re.DOTALL)
    return {
        "readme_words": len(readme.split()),
        "readme_first_sentence_words": len(first_sentence(prose).split()),
        "docs_words": sum(
            len(_GENERATED.sub("", page.read_text("utf-8")).split()) for page in docs
        ),
        "dead_links": dead_links(root),
        "dead_paths": dead_paths(root),
        "readme_figures_unmeasured": [
            each[0] for each in _FIGURE.finditer(prose) if _figure(each) not in known
        ],
    }


def first_sentence(markdown: str) -> str:
    """Return the first sentence of the first paragraph of prose; a bold phrase may be one."""
    for paragraph in re.split(r"\n\s*\n", markdown):
        text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", paragraph).replace("*", "").strip()
        if text and not paragraph.lstrip().startswith(("#", "<", "|", "!", "[!")):
            return re.split(r"(?<=[.!?])\s", text, maxsplit=1)[0]
    return ""


def anchors(page: Path) -> set[str]:
    """Return the anchors that a page's headings and its own `<a name>` make."""
    text = page.read_text("utf-8")
    titles = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    plain = {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}
    return plain | set(re.findall(r'<a (?:name|id)="(.+?)">', text))


def dead_links(root: Path) -> list[str]:
    """List `page: target` of every link within the checkout that leads nowhere."""
    dead = []
    for page in pages(root):
        for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text("utf-8")):
            if target.startswith(("http:", "https:", "mailto:")):
                continue
            file, _, anchor = target.partition("#")
            found = page.parent / file if file else page
            is_page = anchor and found.suffix == ".md"
            if not found.exists() or (is_page and anchor not in anchors(found)):
                dead.append(f"{page.relative_to(root).as_posix()}: {target}")
    return dead


def dead_paths(root: Path) -> list[str]:
    """List `page: path` of every path in backquotes that the checkout does not have.

    The CHANGELOG may name what is gone.
    """
    return [
        f"{page.relative_to(root).as_posix()}: {named}"
        for page in pages(root)
        if page.name != "CHANGELOG.md"
        for named in re.findall(r"`([^`\n]+)`", page.read_text("utf-8"))
        if _OUR_PATH.fullmatch(named) and not (root / named).exists()
    ]


def _figure(found: re.Match[str]) -> tuple[float, str]:
    return float(found[1].replace(",", "")), found[2]


def _sources(root: Path) -> Iterator[Path]:
    for folder in FOLDERS:
        for path in sorted((root / folder).rglob("*.py")):
            inside = path.relative_to(root / folder).parts
            if inside[0] != "build" and not any(part.startswith(".") for part in inside):
                yield path


def _dialect_names(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield the first definition, line and name, of each name that has a word of the dialect."""
    seen = set()
    for node in ast.walk(tree):
        match node:
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name):
                pass
            case ast.ClassDef(name=name) | ast.arg(arg=name):
                pass
            case ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()):
                pass
            case _:
                continue
        words = " ".join(re.findall(r"[A-Z]?[a-z]+|[A-Z]+", name)).lower()
        is_dialect = DIALECT.search(words) or name.lstrip("_") in DIALECT_NAMES
        if is_dialect and name not in seen:
            seen.add(name)
            yield node.lineno, name


def _dialect_words(tree: ast.Module) -> Iterator[tuple[int, str]]:
    for node in ast.walk(tree):
        if isinstance(node, _DOCUMENTED) and ast.get_docstring(node, clean=False) is not None:
            literal = node.body[0].value  # type: ignore[attr-defined]
            for n, line in enumerate(literal.value.splitlines()):
                for word in DIALECT.findall(line.lower()):
                    yield literal.lineno + n, word


def _array_functions(tree: ast.Module) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    """Yield public functions, and methods of public classes, that take or return an array."""
    owners: list[ast.Module | ast.ClassDef] = [
        tree,
        *(each for each in tree.body if isinstance(each, ast.ClassDef) and each.name[0] != "_"),
    ]
    for owner in owners:
        for each in owner.body:
            if isinstance(each, _FUNCTION) and not each.name.startswith("_"):
                given = (*each.args.posonlyargs, *each.args.args, *each.args.kwonlyargs)
                kinds = [each.returns, *(one.annotation for one in given)]
                if any(kind is not None and "Array" in ast.unparse(kind) for kind in kinds):
                    yield each
