"""Fault scripts: what they may say, and one clear line for everything else."""

import subprocess
import sys

import pytest
from places import ROOT

from firmware_bridge.simulator.fault_script import FaultScriptError, read_faults
from firmware_bridge.simulator.faults import AMOUNTS, KINDS, LASTING, ON_SERVOS, Fault
from lipservo.commands.build.sim_bus import sim_bus
from lipsync.errors import UserError

BOMB = "a: &a [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{name}: &{name} [{', '.join([f'*{before}'] * 10)}]\n"
    for before, name in zip("abcdefgh", "bcdefghi", strict=True)
)


def test_a_fault_script_is_read_from_yaml():
    seed, (drop, reboot, load) = read_faults(
        "seed: 7\n"
        "faults:\n"
        "- {kind: drop_reply, probability: 0.01, servos: [2]}\n"
        "- {kind: reboot, at_s: 3.0}\n"
        "- {kind: load, servos: 0, every_s: 5, until_s: 60, lasts_s: 0.5, amount: 0.4}\n",
        n_servos=3,
    )

    assert seed == 7
    assert drop == Fault("drop_reply", servos=(2,), probability=0.01)
    assert reboot == Fault("reboot", at_s=(3.0,))
    assert load == Fault("load", servos=(0,), every_s=5, until_s=60.0, lasts_s=0.5, amount=0.4)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_can_be_scripted(kind):
    keys = "at_s: 1.0" if kind in ON_SERVOS else "probability: 0.5"
    if kind in AMOUNTS:
        keys += f", amount: {int(AMOUNTS[kind].high)}"
    if kind in LASTING:
        keys += ", lasts_s: 2"

    _, (fault,) = read_faults(f"faults: [{{kind: {kind}, {keys}}}]", n_servos=1)

    assert fault.kind == kind


def test_the_example_in_the_manual_is_a_valid_script():
    text = (ROOT / "docs" / "simulator.md").read_text(encoding="utf-8")
    script = text.split("```yaml\n# faults.yaml\n")[1].split("```")[0]

    seed, faults = read_faults(script, n_servos=10)

    assert (seed, len(faults)) == (1, 4)


@pytest.mark.parametrize(
    ("script", "said"),
    [
        ("", "needs `faults: [...]`"),
        ("- 3", "needs `faults: [...]`"),
        ("faults: []\nfault: []", "needs `faults: [...]`"),
        ("seed: x\nfaults: []", "seed: must be a whole number, found 'x'"),
        ("seed: true\nfaults: []", "seed: must be a whole number, found True"),
        ("faults: {kind: reboot}", "faults: must be a list, found a mapping"),
        ("faults:", "faults: must be a list, found nothing"),
        ("faults: [3]", "fault 1: must be a mapping like {kind: reboot, at_s: 3.0}, found 3"),
        ("faults: [{kind: gremlin}]", "fault 1: kind: must be one of answers_stop, babble"),
        ("faults: [{kind: [reboot]}]", "kind: must be one of"),
        ("faults: [{at_s: 1}]", "found nothing"),
        ("faults: [{kind: reboot, at_s: 1, when: 3}]", "fault 1 (reboot): 'when' does not belong"),
        ("faults: [{kind: reboot, at_s: 1, 7: 3}]", "7 does not belong here; this kind has kind,"),
        ("faults: [{kind: reboot, at_s: 1, amount: 3}]", "'amount' does not belong here"),
        ("faults: [{kind: drop_reply, at_s: 1}]", "'at_s' does not belong here"),
        ("faults: [{kind: drop_instruction, servos: 1}]", "'servos' does not belong here"),
        ("faults: [{kind: unplug, at_s: 1, servos: 1}]", "'servos' does not belong here"),
        (
            "faults: [{kind: reboot}]",
            "fault 1 (reboot): this fault never happens; give at_s or every_s",
        ),
        ("faults: [{kind: reboot, at_s: 1, from_s: 2}]", "from_s needs every_s"),
        ("faults: [{kind: reboot, at_s: -1}]", "at_s: must be a number from 0 on, found -1"),
        (
            "faults: [{kind: reboot, at_s: [1, .nan]}]",
            "at_s: must be a number from 0 on, found nan",
        ),
        ("faults: [{kind: reboot, at_s: .inf}]", "from 0 on, found inf"),
        ("faults: [{kind: reboot, at_s: soon}]", "at_s: must be a number from 0 on, found 'soon'"),
        (
            "faults: [{kind: reboot, at_s: 3e2}]",
            "found '3e2' (YAML takes this for text; write 300)",
        ),
        ("faults: [{kind: reboot, at_s: true}]", "found True"),
        ("faults: [{kind: reboot, at_s: []}]", "at_s: must not be empty; leave it out"),
        ("faults: [{kind: reboot, at_s: [[[1]]]}]", "found a list of 1"),
        ("faults: [{kind: reboot, every_s: 0}]", "every_s: must be a number from 0.001 on"),
        (
            "faults: [{kind: reboot, every_s: 1, from_s: 5, until_s: 2}]",
            "later than from_s, found 2",
        ),
        ("faults: [{kind: jam, at_s: 1, lasts_s: -2}]", "lasts_s: must be a number from 0 on"),
        (
            "faults: [{kind: reboot, at_s: 1, servos: [3]}]",
            "a whole number between 0 and 2, found 3",
        ),
        ("faults: [{kind: reboot, at_s: 1, servos: [-1]}]", "between 0 and 2, found -1"),
        ("faults: [{kind: reboot, at_s: 1, servos: jaw}]", "between 0 and 2, found 'jaw'"),
        ("faults: [{kind: reboot, at_s: 1, servos: 1.5}]", "between 0 and 2, found 1.5"),
        (
            "faults: [{kind: drop_reply, probability: 2}]",
            "must be a number between 0 and 1, found 2",
        ),
        (
            "faults: [{kind: late_reply}]",
            "amount: must be a number between 0 and 10 (seconds late)",
        ),
        ("faults: [{kind: id_change, at_s: 1, amount: 253}]", "between 0 and 252 (the new id)"),
        ("faults: [{kind: load, at_s: 1, amount: 1.5}]", "(load as a share of the stall torque)"),
        ("faults: [{kind: reboot, kind: jam}]", "not YAML at line 1: `kind` is given twice"),
        ("faults: [", "not YAML at line 1"),
        ("faults: [2001-13-45]", "a number or date is impossible"),
        ("faults: [" + "9" * 5000 + "]", "a number or date is impossible"),
        ("faults: [{kind: reboot, at_s: " + "9" * 4000 + "}]", "must be"),
        ("faults: " + "[" * 5000 + "]" * 5000, "nested too deep"),
        ("faults: [!!python/object:os.system {}]", "not YAML at line 1"),
        (BOMB + "faults: *i", "needs `faults: [...]`"),
        ("faults:\n- {kind: reboot, at_s: &a [1, 1]}\n- {kind: *a}", "fault 2: kind: must be"),
    ],
)
def test_a_mistake_in_a_script_is_explained_in_one_line(script, said):
    with pytest.raises(FaultScriptError) as problem:
        read_faults(script, n_servos=3)

    assert said in str(problem.value)
    assert "\n" not in str(problem.value)
    assert len(str(problem.value)) < 600


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"\xff\xfe", "is not UTF-8 text"),
        (b"#" * 100_001, "is longer than 100,000 characters"),
        (None, "cannot be read: No such file or directory"),
    ],
)
def test_a_file_that_is_no_script_is_explained(tmp_path, content, said):
    file = tmp_path / "faults.yaml"
    if content is not None:
        file.write_bytes(content)

    with pytest.raises(UserError) as problem:
        sim_bus(faults=file)

    assert str(problem.value).startswith(f"--faults {file}: {said}")


def test_sim_bus_names_the_file_the_fault_and_the_key(tmp_path):
    file = tmp_path / "faults.yaml"
    file.write_text("faults: [{kind: reboot, at_s: -1}]")

    done = subprocess.run(
        [sys.executable, "-m", "lipservo", "sim-bus", "--faults", str(file)],
        capture_output=True,
        text=True,
    )

    said = " ".join(done.stderr.split())
    assert (done.returncode, done.stdout) == (1, "")
    assert f"{file}: fault 1 (reboot): at_s: must be a number from 0 on, found -1" in said
    assert "Traceback" not in said
