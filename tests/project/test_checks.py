"""What a pull request must pass, beside what .ci/run and the Makefile do."""

import re

import yaml
from places import ROOT

CHECKS = yaml.safe_load((ROOT / ".github/workflows/checks.yml").read_text())["jobs"]["checks"]
SCRIPT = "\n".join(step.get("run", "") for step in CHECKS["steps"])
CI = (ROOT / ".ci" / "run").read_text()
TARGETS = re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)


def made(script):
    """The targets of the `make` that both run, in their order."""
    (line,) = re.findall(r"\bmake (check .*)$", script, re.MULTILINE)
    return line.split()


def installed(script):
    """Every Debian package that a script installs."""
    joined = script.replace("\\\n", " ")
    lists = re.findall(r"install .*--no-install-recommends([a-z0-9 -]+)", joined)
    return {package for each in lists for package in each.split()}


def test_a_pull_request_is_checked_by_the_same_targets_as_the_ci():
    assert made(SCRIPT) == made(CI) == ["check", "test"]
    assert set(made(SCRIPT)) <= set(TARGETS)


def test_it_is_checked_with_the_same_debian_packages():
    assert installed(SCRIPT) == installed(CI)
    assert "chromium" in installed(CI)


def test_it_is_checked_on_pythons_that_the_wheel_names():
    named = (ROOT / "pyproject.toml").read_text()

    assert CHECKS["strategy"]["matrix"]["python"] == ["3.11", "3.13"]
    for python in CHECKS["strategy"]["matrix"]["python"]:
        assert f"Python :: {python}" in named
    assert "${{ matrix.python }}" in CHECKS["container"]
