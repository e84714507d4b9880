"""The shape of the tree: small folders, short files, few parameters, names that tell apart."""

import ast
import inspect
from collections import defaultdict

import pytest
from every_command import every_command
from places import ROOT
from source_tree import FOLDER_OF

MOST_FILES, MOST_LINES, MOST_PARAMETERS = 25, 600, 8
#: Everything of ours that lies in the root of the checkout.
FOLDERS = (
    *FOLDER_OF.values(),
    "benchmarks",
    "config",
    "docs",
    "examples",
    "firmware",
    "tests",
    ".github",
    ".ci",
)
#: Folders of tests/ that belong to no package.
OTHER_TESTS = {"data", "examples", "firmware_pico", "project", "support"}


def files(*names):
    """Every file below these folders of the root, but what Python and tools leave there."""
    for name in names:
        for path in sorted((ROOT / name).rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts:
                yield path


def place(path):
    return path.relative_to(ROOT).as_posix()


SOURCES = [path for path in files(*FOLDERS) if path.suffix == ".py"]


def test_no_folder_has_more_files_than_one_looks_through():
    count = defaultdict(int)
    for path in files(*FOLDERS):
        count[place(path.parent)] += 1

    assert {name: n for name, n in count.items() if n > MOST_FILES} == {}


def test_no_file_is_longer_than_one_reads_in_one_go():
    long = {
        place(path) for path in SOURCES if len(path.read_text("utf-8").splitlines()) > MOST_LINES
    }

    assert long == set()


def command_functions():
    """`file:name` of every function that typer calls: found in the whole tree of the program.

    That is, the callbacks of the program, of its groups, and of every command in them, without the
    wrappers that typer and our own decorators put around them.
    """
    found = set()
    for _, command in every_command():
        if command.callback is not None:
            function = inspect.unwrap(command.callback)
            file = inspect.getsourcefile(function)
            found.add(f"{file.removeprefix(f'{ROOT}/')}:{function.__qualname__}")
    return found


def functions(tree, prefix=""):
    """(qualified name, node) of every function in a syntax tree, at any depth."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            name = f"{prefix}{node.name}"
            if not isinstance(node, ast.ClassDef):
                yield name, node
            yield from functions(node, f"{name}.")
        else:
            yield from functions(node, prefix)


def n_parameters(function):
    """How many arguments a caller may give; `self` and `cls` are given by Python."""
    given = function.args
    names = [each.arg for each in (*given.posonlyargs, *given.args, *given.kwonlyargs)]
    bound = names[:1] in (["self"], ["cls"])
    return len(names) - bound + (given.vararg is not None) + (given.kwarg is not None)


def test_no_function_has_more_parameters_than_one_keeps_in_mind():
    """A command's are the options that users type; a data class has fields and no such function."""
    many = {
        f"{place(path)}:{name}"
        for path in SOURCES
        for name, function in functions(ast.parse(path.read_text("utf-8")))
        if n_parameters(function) > MOST_PARAMETERS
    }

    assert many - command_functions() == set()


def test_commands_are_recognised():
    found = command_functions()
    assert len(found) > 25
    assert len({each.split(":")[0] for each in found}) > 20


def folder_tested(name):
    """The folder of a package whose tests lie in this folder of tests/."""
    top, _, rest = name.partition("/")
    return ROOT / FOLDER_OF.get(f"lipservo_{top}", top) / rest


def test_tests_lie_where_the_package_lies_that_they_test():
    folders = {place(path.parent).removeprefix("tests/") for path in files("tests")} - {"tests"}
    strangers = {
        name
        for name in folders
        if name.split("/")[0] not in OTHER_TESTS
        and not (folder_tested(name) / "__init__.py").exists()
    }

    assert strangers == set()


@pytest.mark.parametrize("package", [*FOLDER_OF.values(), "config"])
def test_every_folder_of_a_package_says_what_it_is(package):
    folders = {path.parent for path in files(package) if path.suffix != ".md"}
    silent = []
    for each in folders:
        init = each / "__init__.py"
        if not init.exists() or not ast.get_docstring(ast.parse(init.read_text("utf-8"))):
            silent.append(place(each))

    assert silent == []
