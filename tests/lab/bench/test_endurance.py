"""`bench endurance` in several sessions: nothing is lost or counted twice between them."""

import json

import pytest
from lipservo_lab.campaigns.endurance import endurance_figures
from typer.testing import CliRunner

from lipservo.cli import app


def bench(*arguments):
    return CliRunner().invoke(app, ["bench", "endurance", "--json", "--quiet", *arguments])


def figures_of(n_cycles, resume, stop_after=10**9):
    done = []
    return endurance_figures(n_cycles, done.append, lambda: max(done) >= stop_after, resume)


@pytest.mark.slow
def test_a_stopped_run_goes_on_from_its_file_until_all_cycles_are_done(tmp_path):
    file = tmp_path / "endurance.json"

    first = figures_of(1_200, file, stop_after=300)
    second = figures_of(1_200, file)
    third = figures_of(1_200, file)

    kept = json.loads(file.read_text())["sessions"]
    assert first["cycles"] == 300 == kept[0]["cycles"]
    assert second["cycles"] == 1_200
    assert [each["cycles"] for each in kept] == [300, 900]
    assert second["goals"] == kept[0]["goals"] + kept[1]["goals"] >= 5 * 1_200
    assert third == second  # all done: nothing was run


def test_a_run_that_is_killed_has_lost_a_hundredth_at_most(tmp_path):
    file = tmp_path / "endurance.json"

    class Killed(BaseException):
        pass

    def killed_in_the_middle(n_done):
        if n_done >= 500:
            raise Killed

    with pytest.raises(Killed):
        endurance_figures(1_000, killed_in_the_middle, lambda: False, file)

    assert json.loads(file.read_text())["sessions"][0]["cycles"] == 500
    assert [each.name for each in tmp_path.iterdir()] == ["endurance.json"]


@pytest.mark.slow
def test_what_any_session_saw_counts_and_growth_is_that_of_the_worst(tmp_path):
    file = tmp_path / "endurance.json"
    figures_of(1_000, file)
    kept = json.loads(file.read_text())
    (good,) = kept["sessions"]
    bad = {**good, "motion_too_fast": 2, "rss_mb_at_tenth": 50.0, "rss_mb_at_end": 57.5}
    kept["sessions"].append(bad)
    file.write_text(json.dumps(kept))

    result = bench("--cycles", "1500", "--resume", str(file))

    figures = json.loads(result.stdout)
    assert result.exit_code == 1
    assert figures["cycles"] == 2_000
    assert figures["motion_too_fast"] == 2
    assert figures["rss_growth_mb"] == pytest.approx(7.5)


@pytest.mark.parametrize(
    "content",
    [
        "my notes",
        '{"sessions": []}',
        '{"format": "lipservo bench endurance 1"}',
        '{"format": "lipservo bench endurance 1", "sessions": [{"cycles": 3}]}',
        '{"format": "lipservo bench endurance 1", "sessions"',
    ],
)
def test_a_file_that_holds_something_else_is_refused_and_kept(tmp_path, content):
    file = tmp_path / "endurance.json"
    file.write_text(content)

    result = bench("--cycles", "1000", "--resume", str(file))

    assert result.exit_code == 1
    assert "endurance.json" in str(result.exception) + result.output
    assert file.read_text() == content
