"""`lipservo bench calibration` says in one line what it cannot do."""

import sys

import pytest

from lipservo import command_line


@pytest.mark.parametrize(
    ("arguments", "status", "said"),
    [
        (("--family", "nonsense"), 2, "'nonsense'"),
        (("--seeds", "x"), 1, "--seeds x: expected one number or a range such as 0-19"),
        (("--seeds", "1-2-3"), 1, "--seeds 1-2-3: expected one number"),
        (("--seeds", "-1"), 1, "--seeds -1: expected one number"),
        (("--seeds", "9-3"), 1, "--seeds 9-3: the first is larger than the last"),
        (("--seeds", ""), 1, "expected one number"),
        (("--seeds", "²"), 1, "--seeds ²: expected one number"),
    ],
)
def test_bad_wishes_end_in_one_line(monkeypatch, capsys, arguments, status, said):
    monkeypatch.setattr(sys, "argv", ["lipservo", "bench", "calibration", *arguments])
    with pytest.raises(SystemExit) as end:
        command_line.main()
    assert end.value.code == status
    out, err = capsys.readouterr()
    (line,) = err.splitlines()
    assert line.startswith("lipservo: ")
    assert said in line
    assert out == ""
