"""What `lipservo health` reads out of the log: days, trends, and what to do."""

import json
from datetime import timedelta

import numpy as np
import pytest
from logged_servos import NOON, servo
from typer.testing import CliRunner

from firmware_bridge.bus import HardwareError
from lipservo.cli import app
from lipservo.health.health_history import read_history, theil_sen_slope
from lipservo.health.health_log import append_line, json_line


def run_for_days(folder, n_days, say, n=40, first=NOON):
    """`n` readings a day; `say(day, k)` gives the servos."""
    folder.mkdir(parents=True, exist_ok=True)
    for day in range(n_days):
        moment = first + timedelta(days=day)
        path = folder / f"{moment:%Y-%m-%d}.jsonl"
        text = [json_line(moment + timedelta(seconds=10 * k), k, say(day, k)) for k in range(n)]
        path.write_bytes(b"".join(text))


def health(state, *arguments):
    environment = {"LIPSERVO_STATE": str(state), "COLUMNS": "80"}
    done = CliRunner().invoke(app, ["health", *map(str, arguments)], env=environment)
    return done


def findings(state):
    done = health(state, "--json")
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)["faces"][0]["findings"]


NAMES = ("jaw", "lip_left", "lip_right", "corner")


NOISE = np.random.default_rng(3).normal(size=(30, 40))


def steady(day, k, **jaw):
    """Servos that flicker by a degree and warm up with a room that does by two in ten days."""
    warm = 40.0 + NOISE[day, k] + 0.2 * day
    return [servo(n, temperature_degc=warm, **(jaw if n == "jaw" else {})) for n in NAMES]


def warmer(day, k, load=0.12):
    jaw = servo("jaw", temperature_degc=40.0 + NOISE[day, k] + day, load=load)
    return [jaw, *steady(day, k)[1:]]


def test_a_servo_that_runs_ever_warmer_is_named_with_what_to_do(tmp_path):
    run_for_days(tmp_path / "health" / "mouth", 8, warmer)
    (line,) = findings(tmp_path)

    assert line.startswith("jaw runs ")
    assert "degC warmer than a week ago, compared with the others, at the same load" in line
    assert "look for a joint that binds" in line


def test_steady_servos_in_a_warmer_room_are_left_in_peace(tmp_path):
    run_for_days(tmp_path / "health" / "mouth", 10, steady)

    assert findings(tmp_path) == []
    assert "nothing is getting worse" in health(tmp_path).stdout


def test_one_hot_day_and_one_short_day_are_no_trend(tmp_path):
    def say(day, k):
        return warmer(20, k) if day == 4 else steady(day, k)

    run_for_days(tmp_path / "health" / "mouth", 8, say)
    run_for_days(tmp_path / "health" / "mouth", 1, warmer, n=5, first=NOON + timedelta(days=20))

    assert findings(tmp_path) == []


@pytest.mark.parametrize(
    ("say", "said"),
    [
        (lambda d, k: warmer(d, k, load=0.12 + 0.02 * d), "under more load: a joint that binds"),
        (lambda d, k: steady(d, k, load=0.12 + 0.02 * d), "jaw pulls 14% of its stall torque more"),
        (lambda d, k: steady(d, k, voltage_v=5.0 - 0.1 * d), "jaw gets 0.7 V less at worst"),
        (
            lambda d, k: steady(d, k, hardware_errors=HardwareError.OVERLOAD * (d == 7)),
            "jaw reported overload (2026-11-29)",
        ),
        (lambda d, k: steady(d, k, n_reboots=2 * (d == 7)), "jaw was restarted 2 times"),
        (
            lambda d, k: steady(d, k, n_unanswered=k if d == 7 else 0),
            "jaw left 351 questions an hour unanswered, 0 before",
        ),
        (
            lambda d, _: [servo(n, temperature_degc=40.0 + d) for n in NAMES],
            "all servos run 7 degC warmer than a week ago",
        ),
    ],
)
def test_what_gets_worse_is_told_in_a_sentence(tmp_path, say, said):
    run_for_days(tmp_path / "health" / "mouth", 8, say)
    found = findings(tmp_path)

    assert len(found) == 1, found
    assert said in found[0]


def test_counts_go_on_over_midnight_and_begin_anew_with_a_run(tmp_path):
    """3 in the evening, 2 more after midnight; then a new run in which 1 goes unanswered."""
    moments = [NOON, NOON + timedelta(days=1)]
    said = [(0, 0, 0), (0, 1, 3), (1, 2, 5), (1, 0, 1)]
    for day, number, n in said:
        path = tmp_path / f"{moments[day]:%Y-%m-%d}.jsonl"
        append_line(path, json_line(moments[day], number, [servo(n_unanswered=n)]))

    days = read_history([tmp_path], 30).servos["jaw"]
    assert [day.n_unanswered for day in days] == [3, 3]
    # A log that begins in the middle of a run does not count what was before.
    (tmp_path / "2026-11-22.jsonl").unlink()
    (day,) = read_history([tmp_path], 30).servos["jaw"]
    assert day.n_unanswered == 1


@pytest.mark.parametrize(("was_on", "counted"), [(True, 5), (False, 0)])
def test_the_silence_of_a_servo_counts_if_it_was_on_when_it_was_last_known(
    tmp_path, was_on, counted
):
    """While it is silent its torque is unknown."""
    for number, on in enumerate((was_on, None)):
        line = json_line(NOON, number, [servo(torque_on=on, n_unanswered=5 * number)])
        append_line(tmp_path / "2026-11-22.jsonl", line)

    (day,) = read_history([tmp_path], 30).servos["jaw"]
    assert day.n_unanswered == counted


def test_lines_that_are_damaged_are_counted_and_left_out(tmp_path):
    folder = tmp_path / "health" / "mouth"
    run_for_days(folder, 1, steady)
    good = json_line(NOON, 0, [servo()]).decode()
    bad = [
        good[:40], "[]", "{}", "nonsense", "\x00\x00", "[" * 100_000, "1e999",
        good.replace("[40]", '["hot"]'), good.replace("[40]", "[40,41]"),
        good.replace("[40]", f"[{10**400}]"), good.replace('"errors":[0]', '"errors":[256]'),
        good.replace('["jaw"]', "[3]"), good.replace('"errors":[0]', '"errors":[null]'),
    ]  # fmt: skip
    with (folder / "2026-11-22.jsonl").open("a") as file:
        file.write("\n".join(bad))
    (folder / "2026-99-99.jsonl").write_text(good)
    done = health(tmp_path)

    assert done.exit_code == 0, done.exception
    assert f"mouth: {len(bad)} unreadable lines of the log were left out" in done.stderr
    assert "40 readings" in done.stdout


def test_the_table_fits_a_terminal_of_80_columns(tmp_path):
    names = ("corner_right_out", "upper_lip_left")
    run_for_days(
        tmp_path / "health" / "mouth", 2, lambda _, k: [servo(n, n_unanswered=k) for n in names]
    )
    done = health(tmp_path)

    assert max(len(line.rstrip()) for line in done.stdout.splitlines()) <= 80
    row = next(line for line in done.stdout.splitlines() if "corner_right_out" in line)
    assert row.split() == ["corner_right_out", "40", "40", "12%", "180", "5.0", "none", "0", "78"]


def test_nothing_logged_yet_is_one_clear_line(tmp_path):
    done = health(tmp_path)

    assert done.exit_code == 0
    (line,) = done.stdout.splitlines()
    assert line.startswith("nothing logged yet")
    assert health(tmp_path, "--json").stdout.strip() == '{"faces": []}'


def test_a_face_that_is_not_known_is_refused_with_those_that_are(tmp_path):
    run_for_days(tmp_path / "health" / "my-mouth", 1, steady)
    done = health(tmp_path, "--face", "head")

    assert "known here: my-mouth" in str(done.exception)
    assert health(tmp_path, "--face", "My mouth").exit_code == 0


def test_the_slope_is_that_of_scipy():
    stats = pytest.importorskip("scipy.stats")
    rng = np.random.default_rng(5)
    for _ in range(20):
        times = np.sort(rng.choice(60, 9, replace=False)).astype(float)
        values = rng.normal(size=9) + 0.3 * times
        assert theil_sen_slope(times, values) == pytest.approx(
            stats.theilslopes(values, times).slope
        )
