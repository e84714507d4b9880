"""Mutants of the lines that a stop depends on, each against the nearest tests: `make mutants`.

The operators, the change of the source and the run of the tests are cosmic-ray's; which files,
which tests, how many mutants, and the survivors that were read are in mutants.yaml beside it:
docs/decisions/tests-and-mutants.md. Each worker mutates a copy of the checkout of its own.
"""

import argparse
import ast
import difflib
import hashlib
import json
import os
import queue
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from operator import itemgetter
from pathlib import Path

import yaml
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.operators.operator import Operator
from cosmic_ray.plugins import get_operator, operator_names
from cosmic_ray.testing import run_tests
from cosmic_ray.work_item import TestOutcome
from parso.python.tree import Keyword
from parso.tree import NodeOrLeaf

ROOT = Path(__file__).parents[3]
PLAN = Path(__file__).with_name("mutants.yaml")
#: A mutant that hangs is killed by the clock: so many times what the tests take without one.
_PATIENCE, _LEAST_PATIENCE_S = 4.0, 15.0
#: Plugins of other packages cost a second a mutant; with CI set Hypothesis draws the same examples
#: every time.
_ENVIRONMENT = {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "CI": "true"}


class StatementRemoval(Operator):
    """Leaves out a call, an assignment to an attribute, or an error; not a line of a log."""

    def mutation_positions(self, node: NodeOrLeaf) -> Iterator[tuple]:
        first = node.children[0] if node.type == "simple_stmt" else None
        assigns = first is not None and first.type == "expr_stmt"
        target = first.children[0] if assigns else first
        is_line = node.type == "simple_stmt" and node.get_first_leaf().value == "_LOG"
        if not is_line and getattr(target, "type", "") in ("atom_expr", "power", "raise_stmt"):
            yield first.start_pos, first.end_pos

    def mutate(self, node: NodeOrLeaf, _index: int) -> NodeOrLeaf:
        first = node.children[0]
        node.children[0] = Keyword("pass", first.start_pos, first.get_first_leaf().prefix)
        return node

    @classmethod
    def examples(cls) -> tuple:
        return ()


class OtherMember(Operator):
    """Puts another member of an enumeration in place of one: `State.LIMP` of `State.ARMED`."""

    def _others(self, node: NodeOrLeaf) -> list[str]:
        if node.type != "name" or not re.fullmatch(r"[A-Z][A-Z0-9_]+", node.value):
            return []
        dot = node.get_previous_leaf()
        owner = dot and dot.get_previous_leaf()
        if not (owner and dot.value == "." and re.fullmatch(r"_?[A-Z]\w*", owner.value)):
            return []
        text = node.get_root_node().get_code()
        members = re.findall(rf"\b{owner.value}\.([A-Z][A-Z0-9_]+)\b", text)
        return sorted({*members} - {node.value})

    def mutation_positions(self, node: NodeOrLeaf) -> Iterator[tuple]:
        for _ in self._others(node):
            yield node.start_pos, node.end_pos

    def mutate(self, node: NodeOrLeaf, index: int) -> NodeOrLeaf:
        node.value = self._others(node)[index]
        return node

    @classmethod
    def examples(cls) -> tuple:
        return ()


@dataclass(frozen=True)
class Mutant:
    """A change of one place in a file. above: the nearest comment, or the function's docstring."""

    file: str
    line_number: int
    function: str
    line: str
    becomes: str
    above: str
    code: str
    diff: str

    @property
    def key(self) -> tuple[str, ...]:
        """What it is known by, whatever lines are added elsewhere."""
        return self.file, self.function, self.line, self.becomes


class Source:
    """A file as it is: its text, which function a line is in, and what is said above it."""

    def __init__(self, file: str) -> None:
        self.file, self.text = file, (ROOT / file).read_text(encoding="utf-8")
        self.lines, tree = self.text.split("\n"), ast.parse(self.text)
        self.dump, nodes = ast.dump(tree), list(ast.walk(tree))
        kinds = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
        within = sorted((n for n in nodes if isinstance(n, kinds)), key=lambda node: node.lineno)
        #: First and last line, name and docstring of functions and classes, the outer ones first.
        self._spans = [
            (each.lineno, each.end_lineno, each.name, ast.get_docstring(each) or "")
            for each in within
        ]
        told = [getattr(n, "annotation", None) or getattr(n, "returns", None) for n in nodes]
        made = [n for each in within for n in each.decorator_list if isinstance(n, ast.Call)]
        #: Annotations are not run, and whether an object is frozen is no matter of a test.
        self.left_out = [
            ((each.lineno, each.col_offset), (each.end_lineno, each.end_col_offset))
            for each in [*told, *made]
            if each is not None
        ]

    def function(self, row: int) -> str:
        """Names of the class and the function around a line."""
        names = [name for first, last, name, _ in self._spans if first <= row <= last]
        return ".".join(names) or "(module)"

    def above(self, row: int) -> str:
        """The comment in the line or above it in its paragraph; else what the function says."""
        if "#" in self.lines[row - 1]:
            return self.lines[row - 1].partition("#")[2].strip(" :")
        for line in reversed(self.lines[: row - 1]):
            if line.strip().startswith("#"):
                return line.strip("# :")
            if not line.strip() or re.match(r"\s*(def|class) ", line):
                break
        told = [doc for first, last, _, doc in self._spans if first <= row <= last]
        return told[-1].partition("\n")[0] if told else ""

    def mutant(self, row: int, operator: Operator, occurrence: int) -> "Mutant | None":
        """A mutant, or None where the changed text is no Python or the same Python."""
        code = mutate_code(self.text, operator, occurrence)
        try:
            if code is None or ast.dump(ast.parse(code)) == self.dump:
                return None
        except SyntaxError:
            return None
        diff = list(
            difflib.unified_diff(
                self.lines, code.split("\n"), self.file, self.file, lineterm="", n=2
            )
        )
        line, becomes = (
            " ".join(" ".join(each[1:] for each in diff[2:] if each[0] == sign).split())
            for sign in "-+"
        )
        where = self.file, row, self.function(row)
        return Mutant(*where, line, becomes, self.above(row), code, "\n".join(diff))


def drawn(plan: dict) -> list[Mutant]:
    """The mutants of the plan: one a place, and of the places those that the seed draws.

    They are drawn by a hash of what stands there, so that a change elsewhere draws no others.
    """
    left_out = re.compile("|".join(plan["operators_left_out"]))
    kinds = [get_operator(name) for name in operator_names() if not left_out.search(name)]
    operators = [kind() for kind in kinds if not kind.arguments()]
    places: dict[tuple, tuple] = {}
    for file in {file: None for group in plan["groups"] for file in fitting(group["files"])}:
        source = Source(file)
        nodes = list(ast_nodes(get_ast(source.text)))
        for operator in [*operators, StatementRemoval(), OtherMember()]:
            positions = (each for node in nodes for each in operator.mutation_positions(node))
            seen: Counter[tuple[int, int]] = Counter()
            for occurrence, (start, _) in enumerate(positions):
                seen[start] += 1
                if any(first <= start < last for first, last in source.left_out):
                    continue
                line, kind = source.lines[start[0] - 1], type(operator).__name__
                column = start[1] - len(line) + len(line.lstrip())
                where = plan["seed"], file, source.function(start[0]), line.strip(), column
                ranks = _hash(*where), _hash(*where, kind, seen[start])
                change = *ranks, source, operator, occurrence
                known = places.setdefault((file, start), change)
                places[file, start] = min(known, change, key=itemgetter(0, 1))
    found: list[Mutant] = []
    for (_, (row, _)), (*_, source, operator, occurrence) in sorted(
        places.items(), key=lambda item: item[1][:2]
    ):
        mutant = source.mutant(row, operator, occurrence)
        found += [mutant] if mutant is not None else []
        if len(found) == plan["mutants"]:
            break
    return found


def fitting(patterns: list[str]) -> list[str]:
    """The files of the checkout that fit; SystemExit where nothing fits a pattern."""
    found: list[str] = []
    for pattern in patterns:
        those = sorted(str(path.relative_to(ROOT)) for path in ROOT.glob(pattern))
        if not those:
            raise SystemExit(f"{PLAN}: no file fits {pattern}: name the file that took its place")
        found += [each for each in those if each not in found]
    return found


def _hash(*words: object) -> str:
    return hashlib.sha256(repr(words).encode()).hexdigest()


def copied_tree(folder: Path) -> Path:
    """A copy of the checkout as it lies there, without what git ignores."""
    listed = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    for name in subprocess.check_output(listed, cwd=ROOT, text=True).split("\0"):
        if name and (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    return folder


def command(tree: Path, tests: list[str]) -> str:
    """The command that runs the tests in a copy of the checkout, until the first that fails."""
    path = f"PYTHONPATH={tree}:{tree / 'client'}:{tree / 'lab'}"
    pytest = f"{sys.executable} -m pytest -x -q --no-header -p no:cacheprovider"
    return f"env --chdir={tree} {path} {pytest} {' '.join(tests)}"


def baseline_s(tree: Path, tests: list[str]) -> float:
    """Seconds that the tests take without a mutant. Raises SystemExit where they fail."""
    for _ in range(2):  # once more alone, and the first writes what is kept of test files
        begun_s = time.monotonic()
        run = subprocess.run(command(tree, tests).split(), capture_output=True, text=True)
        if run.returncode == 0:
            return time.monotonic() - begun_s
    raise SystemExit(f"fails without a mutant: {' '.join(tests)}\n{run.stdout[-3000:]}")


def tried(mutant: Mutant, tree: Path, tests: list[str], limit_s: float) -> str:
    """What became of a mutant: `killed`, `timed out` or `survived`."""
    path = tree / mutant.file
    source = path.read_text(encoding="utf-8")
    path.write_text(mutant.code, encoding="utf-8")
    try:
        outcome, output = run_tests(command(tree, tests), limit_s)
    finally:
        path.write_text(source, encoding="utf-8")
    if outcome is TestOutcome.INCOMPETENT:
        raise SystemExit(f"the tests could not be run:\n{output}")
    if outcome is TestOutcome.SURVIVED:
        return "survived"
    return "timed out" if output == "timeout" else "killed"


def all_tried(plan: dict, mutants: list[Mutant], n_workers: int) -> list[str]:
    """What became of each mutant, tried by so many workers, each in a copy of the checkout."""
    tests = {
        file: fitting(group["tests"])
        for group in plan["groups"]
        for file in fitting(group["files"])
    }
    with tempfile.TemporaryDirectory(prefix="lipservo-mutants-") as folder:
        trees: queue.SimpleQueue[Path] = queue.SimpleQueue()
        for n in range(n_workers):
            trees.put(copied_tree(Path(folder, str(n))))
        first = Path(folder, "0")
        limits_s = {
            of: max(_LEAST_PATIENCE_S, _PATIENCE * baseline_s(first, list(of)))
            for of in {tuple(tests[mutant.file]) for mutant in mutants}
        }

        def one(mutant: Mutant) -> str:
            tree, nearest = trees.get(), tests[mutant.file]
            try:
                outcome = tried(mutant, tree, nearest, limits_s[tuple(nearest)])
            finally:
                trees.put(tree)
            sys.stderr.write(f"{outcome:9} {mutant.file}:{mutant.line_number} {mutant.becomes}\n")
            return outcome

        with ThreadPoolExecutor(n_workers) as pool:
            return list(pool.map(one, mutants))


def figures(plan: dict, mutants: list[Mutant], outcomes: list[str]) -> dict:
    """Counts, the share that was killed, and every survivor with what was written of it."""
    read = {
        (each["file"], each["function"], each["line"], each["becomes"]): each
        for each in plan["read"] or []
    }
    survivors = []
    for mutant, outcome in zip(mutants, outcomes, strict=True):
        if outcome == "survived":
            told = {key: value for key, value in asdict(mutant).items() if key != "code"}
            of_it = read.get(mutant.key, {})
            told |= {"reason": of_it.get("reason", ""), "promise": of_it.get("promise", False)}
            survivors.append(told)
    n_killed = len(mutants) - len(survivors)
    return {
        "mutants": len(mutants),
        "killed": n_killed,
        "timed_out": outcomes.count("timed out"),
        "survived": len(survivors),
        "share": round(n_killed / max(len(mutants), 1), 4),
        "survivors_among_promises": sum(each["promise"] for each in survivors),
        "not_read": sum(not each["reason"] for each in survivors),
        "survivors": survivors,
    }


def main() -> int:
    """Print what became of the mutants; 1 where fewer are killed than the plan wants."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="print all figures as JSON")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--mutants", type=int, help="how many, in place of the plan's number")
    parser.add_argument("--only", default="", help="files whose path has this in it")
    options = parser.parse_args()
    os.environ.update(_ENVIRONMENT)
    plan = yaml.safe_load(PLAN.read_text(encoding="utf-8"))
    plan["mutants"] = options.mutants or plan["mutants"]
    for group in plan["groups"]:
        group["files"] = [file for file in fitting(group["files"]) if options.only in file]
    begun_s = time.monotonic()
    mutants = drawn(plan)
    result = figures(plan, mutants, all_tried(plan, mutants, options.workers))
    result["elapsed_s"] = round(time.monotonic() - begun_s)
    if options.json:
        sys.stdout.write(json.dumps(result, indent=1) + "\n")
    else:
        for each in result["survivors"]:
            reason = each["reason"] or "NOT READ"
            sys.stdout.write(f"\n{each['file']}:{each['line_number']} in {each['function']}\n")
            sys.stdout.write(f"{each['diff']}\nabove: {each['above']}\nreason: {reason}\n")
        counts = {key: value for key, value in result.items() if key != "survivors"}
        sys.stdout.write("\n" + "  ".join(f"{key} {value}" for key, value in counts.items()) + "\n")
    good = result["share"] >= plan["least_share"] and not result["survivors_among_promises"]
    return 0 if good and not result["not_read"] else 1


if __name__ == "__main__":
    raise SystemExit(main())
