"""Whatever a distribution imports is declared in its pyproject.toml, and the other way round."""

import re
import sys
import tomllib

import pytest
from places import ROOT
from source_tree import MODULES, imported

from lipsync.errors import EXTRA_OF, MissingExtraError, check_extra

#: Of each distribution: its folder, and the packages in it.
DISTRIBUTIONS = {
    "lipservo": (ROOT, ("calibration", "firmware_bridge", "lipservo", "lipsync")),
    "lipservo-client": (ROOT / "client", ("lipservo_client",)),
    "lipservo-lab": (ROOT / "lab", ("lipservo_lab",)),
}
OUR_PACKAGES = {package for _, packages in DISTRIBUTIONS.values() for package in packages}
PROJECTS = {
    name: tomllib.loads((folder / "pyproject.toml").read_text())["project"]
    for name, (folder, _) in DISTRIBUTIONS.items()
}
#: The packages of the card: every robot has them.
OF_THE_CARD = {"numpy", "scikit-learn", "pyserial", "dynamixel-sdk", "sounddevice", "pyyaml"}
#: Where a distribution is not called as the library in it.
DISTRIBUTION_OF = {
    "PIL": "pillow",
    "cv2": "opencv-python-headless",
    "livekit": "livekit-agents",
    "markdown_it": "markdown-it-py",
    "pipecat": "pipecat-ai",
    "piper": "piper-tts",
    "serial": "pyserial",
    "sklearn": "scikit-learn",
    "yaml": "pyyaml",
}


def distributions(requirements: list[str]) -> set[str]:
    names = {re.split(r"[\[<>=]", each)[0].strip().lower() for each in requirements}
    return names - set(DISTRIBUTIONS)


#: By pytest itself, for `simulated_face`; by a client for samples that are arrays; by the bench of
#: agents, of `make agents`.
IMPORTED_WHERE_IT_IS = {
    "lipservo": {"pytest"},
    "lipservo-client": {"numpy"},
    "lipservo-lab": {"openai"},
}
MANDATORY = {name: distributions(each["dependencies"]) for name, each in PROJECTS.items()}
EXTRAS = {
    f"{name}[{extra}]": distributions(each)
    for name, project in PROJECTS.items()
    for extra, each in project["optional-dependencies"].items()
}


def distribution(library: str) -> str:
    return DISTRIBUTION_OF.get(library, library.replace("_", "-"))


def imported_libraries(name: str) -> dict[str, str]:
    """Every library of somebody else's that a distribution imports, and one module that does."""
    _, packages = DISTRIBUTIONS[name]
    found = {
        library.split(".")[0]: module
        for module in MODULES
        if module.split(".")[0] in packages
        for library in imported(module)
    }
    ours = {*OUR_PACKAGES, *sys.stdlib_module_names}
    return {library: module for library, module in found.items() if library not in ours}


@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_every_imported_library_is_declared(name):
    undeclared = {
        library: path
        for library, path in imported_libraries(name).items()
        if distribution(library) not in MANDATORY[name] and library not in EXTRA_OF
    }
    assert undeclared.keys() - IMPORTED_WHERE_IT_IS[name] == set(), undeclared


def test_every_library_of_an_extra_is_in_that_extra_and_not_mandatory():
    for library, extra in EXTRA_OF.items():
        assert distribution(library) in EXTRAS[extra]
        assert distribution(library) not in MANDATORY["lipservo"]


def test_everything_declared_is_imported():
    used = {distribution(library) for name in DISTRIBUTIONS for library in imported_libraries(name)}
    for_users = [each for name, each in EXTRAS.items() if name not in _FOR_US]
    assert set().union(*MANDATORY.values(), *for_users) - used == set()


_FOR_US = ("lipservo[dev]", "lipservo[docs]", "lipservo[mutants]")


def test_every_library_has_its_reason_in_the_page_of_dependencies():
    page = (ROOT / "docs" / "decisions" / "dependencies.md").read_text("utf-8")
    for_users = [each for name, each in EXTRAS.items() if name != "lipservo[dev]"]
    declared = set().union(*MANDATORY.values(), *for_users)
    assert declared - set(re.findall(r"[\w-]+", page)) == set()


def test_the_program_needs_every_package_of_the_card_or_its_extra_does_that_fits():
    """scikit-learn fits a calibration, no running face loads it: docs/decisions/dependencies.md."""
    assert MANDATORY["lipservo"] | EXTRAS["lipservo[fit]"] >= OF_THE_CARD


def test_the_three_are_of_one_version_and_need_each_other_by_it():
    (version,) = {project["version"] for project in PROJECTS.values()}
    assert f"lipservo-client=={version}" in PROJECTS["lipservo"]["dependencies"]
    assert f"lipservo=={version}" in PROJECTS["lipservo-lab"]["dependencies"]


def test_an_absent_library_is_one_line_that_names_its_extra(monkeypatch):
    monkeypatch.setitem(EXTRA_OF, "no_such_library", "lipservo[align]")
    with pytest.raises(MissingExtraError) as raised:
        check_extra("no_such_library", "aligning")
    assert str(raised.value) == (
        "aligning needs no_such_library, which is not installed: `pip install 'lipservo[align]'`"
    )
