"""Whatever the four packages import is declared in pyproject.toml, and the other way round."""

import ast
import re
import sys
import tomllib

import pytest
from places import ROOT

from lipsync.extras import EXTRA_OF, MissingExtraError, check_extra

PACKAGES = ("calibration", "firmware_bridge", "lipservo", "lipsync")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
#: Where a distribution is not called as the library in it.
DISTRIBUTION_OF = {
    "cv2": "opencv-python-headless",
    "pipecat": "pipecat-ai",
    "ruamel": "ruamel.yaml",
    "serial": "pyserial",
    "sklearn": "scikit-learn",
    "yaml": "pyyaml",
}


def distributions(requirements: list[str]) -> set[str]:
    names = {re.split(r"[\[<>=]", each)[0].strip().lower() for each in requirements}
    return names - {"lipservo"}


MANDATORY = distributions(PROJECT["dependencies"])
EXTRAS = {name: distributions(each) for name, each in PROJECT["optional-dependencies"].items()}


def distribution(library: str) -> str:
    return DISTRIBUTION_OF.get(library, library.replace("_", "-"))


def imported_libraries() -> dict[str, str]:
    """Every library of somebody else's that is imported anywhere, and one file that does."""
    found = {}
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                modules = []
                if isinstance(node, ast.Import):
                    modules = [alias.name for alias in node.names]
                elif isinstance(node, ast.ImportFrom):
                    modules = [node.module or ""]
                for library in {module.split(".")[0] for module in modules}:
                    found[library] = str(path.relative_to(ROOT))
    ours = {*PACKAGES, *sys.stdlib_module_names}
    return {library: path for library, path in found.items() if library not in ours}


def test_every_imported_library_is_declared():
    undeclared = {
        library: path
        for library, path in imported_libraries().items()
        if distribution(library) not in MANDATORY and library not in EXTRA_OF
    }
    assert undeclared == {}


def test_every_library_of_an_extra_is_in_that_extra_and_not_mandatory():
    for library, extra in EXTRA_OF.items():
        assert distribution(library) in EXTRAS[extra]
        assert distribution(library) not in MANDATORY


def test_everything_declared_is_imported():
    used = {distribution(library) for library in imported_libraries()}
    for_users = {name: each for name, each in EXTRAS.items() if name not in ("dev", "docs")}
    assert MANDATORY.union(*for_users.values()) - used == set()


def test_an_absent_library_is_one_line_that_names_its_extra(monkeypatch):
    monkeypatch.setitem(EXTRA_OF, "no_such_library", "align")
    with pytest.raises(MissingExtraError) as raised:
        check_extra("no_such_library", "aligning")
    assert str(raised.value) == (
        "aligning needs no_such_library, which is not installed: `pip install 'lipservo[align]'`"
    )
