"""What keeps a project in order: versions, numbered decisions, links, checks before a commit."""

import re
import tomllib

import pytest
import yaml
from places import ROOT

PAGES = sorted(
    path
    for folder in ("", "config", "docs", "examples", "firmware", "lipservo", "lipsync", ".github")
    for path in ((ROOT / folder).rglob("*.md") if folder else ROOT.glob("*.md"))
)
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


def headings(path):
    """The anchors that a page's headings and its own `<a name>` make."""
    text = path.read_text("utf-8")
    titles = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    plain = [re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles]
    return {*plain, *re.findall(r'<a name="(.+?)">', text)}


def test_every_link_between_pages_leads_somewhere():
    dead = []
    for page in PAGES:
        for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text("utf-8")):
            if target.startswith(("http:", "https:")):
                continue
            file, _, anchor = target.partition("#")
            found = page.parent / file if file else page
            is_page = anchor and found.suffix == ".md"
            if not found.exists() or (is_page and anchor not in headings(found)):
                dead.append((page.relative_to(ROOT).as_posix(), target))

    assert dead == []


def test_a_file_of_ours_that_is_named_by_its_decision_exists():
    """Code and configuration name pages of docs/decisions by number."""
    known = {name[:4] for name in DECISIONS}
    wrong = []
    for path in (*ROOT.rglob("*.py"), *PAGES, ROOT / "pyproject.toml"):
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
