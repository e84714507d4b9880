"""What keeps a project in order: versions, numbered decisions, links, checks before a commit."""

import re
import tomllib

import pytest
import yaml
from lipservo_lab.bench.house.code_lines import pages
from places import ROOT
from word_figures import dead_links, dead_paths

DECISIONS = sorted(path.name for path in (ROOT / "docs" / "decisions").glob("[0-9]*.md"))


def test_the_newest_version_of_the_changelog_is_the_version_of_the_program():
    text = (ROOT / "CHANGELOG.md").read_text("utf-8")
    headings = re.findall(r"^## \[(.+?)\](?: - (\d{4}-\d\d-\d\d))?$", text, re.MULTILINE)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]

    assert headings[0] == ("Unreleased", "")
    assert headings[1][0] == project["version"]
    dates = [date for _, date in headings[1:]]
    assert all(dates)
    assert dates == sorted(dates, reverse=True)
    kinds = set(re.findall(r"^### (.+)$", text, re.MULTILINE))
    assert kinds <= {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}


def test_decisions_are_numbered_one_after_the_other():
    assert [int(name[:4]) for name in DECISIONS] == list(range(1, len(DECISIONS) + 1))


def test_the_index_of_decisions_has_one_line_for_each_in_order():
    index = (ROOT / "docs" / "decisions" / "README.md").read_text("utf-8")
    assert re.findall(r"^\| \[\d{4}\]\((.+?)\) \|", index, re.MULTILINE) == DECISIONS


def test_the_index_of_docs_leads_to_every_page():
    index = (ROOT / "docs" / "README.md").read_text("utf-8")
    pages = {path.name for path in (ROOT / "docs").glob("*.md")} - {"README.md"}
    assert {name for name in pages if f"]({name}" not in index} == set()


def test_the_glossary_is_in_alphabetical_order_and_says_where_each_term_is_from():
    text = (ROOT / "docs" / "glossary.md").read_text("utf-8")
    rows = re.findall(r"^\| \*\*(.+?)\*\* \| (.+?) \| (.+?) \|$", text, re.MULTILINE)
    terms = [term for term, _, _ in rows]

    assert terms == sorted(terms, key=str.lower)
    assert len(terms) > 40


def test_every_link_and_path_in_a_page_leads_somewhere():
    assert dead_links(ROOT) == []
    assert dead_paths(ROOT) == []


def test_a_file_of_ours_that_is_named_by_its_decision_exists():
    """Code and configuration name pages of docs/decisions by number."""
    known = {name[:4] for name in DECISIONS}
    wrong = []
    for path in (*ROOT.rglob("*.py"), *pages(ROOT), ROOT / "pyproject.toml"):
        if {".venv", ".venv-agents", "build", "site"} & set(path.relative_to(ROOT).parts):
            continue
        for number in re.findall(r"docs/decisions/(\d{4})", path.read_text("utf-8")):
            if number not in known:
                wrong.append((path.name, number))
    assert wrong == []


def test_a_commit_is_checked_as_make_check_does():
    recipe = (ROOT / "Makefile").read_text().split("\ncheck:")[1].split("\n\n")[0]
    asked = set(re.findall(r"^\t\$\(BIN\)/((?:ruff|mypy).*)$", recipe, re.MULTILINE))
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"]
    (ours,) = [repo["hooks"] for repo in hooks if repo["repo"] == "local"]
    mark = ".venv/bin/"
    entries = [hook["entry"] for hook in ours if hook["entry"].startswith(mark)]

    assert {entry.removeprefix(mark) for entry in entries} == asked
    assert all({"id", "name", "language"} <= set(hook) for hook in ours)


@pytest.mark.parametrize("name", ["fault.yml", "proposal.yml"])
def test_issue_templates_are_forms(name):
    form = yaml.safe_load((ROOT / ".github" / "ISSUE_TEMPLATE" / name).read_text())

    assert {"name", "description", "body"} <= set(form)
    assert all(item["type"] in ("textarea", "input") for item in form["body"])
    assert len({item["id"] for item in form["body"]}) == len(form["body"])
