"""What keeps a project in order: versions, pages of decisions, links, checks before a commit."""

import re
import tomllib

import pytest
import yaml
from lipservo_lab.bench.house.code_lines import budgets, pages, sources
from places import ROOT
from word_figures import anchors, dead_links, dead_paths

DECISIONS = ROOT / "docs" / "decisions"
SUBJECTS = {path.name for path in DECISIONS.glob("*.md")} - {"README.md"}
#: Pages were numbered once, one a decision; the numbers are still cited.
OLD_NUMBERS = [f"{number:04}" for number in range(1, 96)]
#: Words, so that a newcomer reads all of it in an afternoon.
MOST_WORDS, MOST_WORDS_OF_A_PAGE = 25_000, 2_500
#: Folders of source, and the files that declare what is installed.
FOLDERS = budgets()["all"].folders
PROJECTS = ("pyproject.toml", "client/pyproject.toml", "lab/pyproject.toml")


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


def test_the_index_of_decisions_has_one_line_for_each_subject():
    index = (DECISIONS / "README.md").read_text("utf-8")
    listed = re.findall(r"^- \[(\S+\.md)\]\(\1\): ", index, re.MULTILINE)
    assert sorted(listed) == sorted(SUBJECTS)


def test_every_old_number_of_a_decision_leads_to_an_anchor():
    index = (DECISIONS / "README.md").read_text("utf-8")
    rows = re.findall(r"^- (\d{4}): \[.+?\]\((\S+?)#(\S+?)\)$", index, re.MULTILINE)

    assert [number for number, _, _ in rows] == OLD_NUMBERS
    known = {name: anchors(DECISIONS / name) for name in SUBJECTS}
    assert [row for row in rows if row[2] not in known.get(row[1], ())] == []


def test_decisions_can_be_read_in_an_afternoon():
    words = {path.name: len(path.read_text("utf-8").split()) for path in DECISIONS.glob("*.md")}

    assert {name: n for name, n in words.items() if n > MOST_WORDS_OF_A_PAGE} == {}
    assert sum(words.values()) <= MOST_WORDS


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


def test_every_page_of_decisions_that_a_file_names_exists():
    """Code, configuration and workflows name pages of docs/decisions; numbers are gone."""
    wrong = []
    for path in named_in():
        for name in re.findall(r"\bdecisions/([\w-]+(?:\.md)?)", path.read_text("utf-8")):
            if name not in {*SUBJECTS, "README.md"}:
                wrong.append((path.relative_to(ROOT).as_posix(), name))
    assert wrong == []


def named_in():
    """Every file of ours that may name a page of decisions."""
    yield from pages(ROOT)
    for folder in (*FOLDERS, "tests"):
        yield from sources(ROOT, folder)
    for name in ("Makefile", "mkdocs.yml", *PROJECTS):
        yield ROOT / name
    for folder in (".github", "lab/lipservo_lab", "tests/support"):
        yield from (ROOT / folder).rglob("*.y*ml")


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
