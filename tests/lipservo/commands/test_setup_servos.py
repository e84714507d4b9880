"""`setup-servos` as it is typed, on simulated servos in memory: in the chain, and one alone."""

import json
import random
import signal

import pytest
from lipservo_lab.campaigns.line_campaign import Disturbance, DisturbedTransport
from typer.testing import CliRunner

from firmware_bridge.clock import ManualClock
from firmware_bridge.dynamixel.control_table import register
from firmware_bridge.dynamixel.mounting import mounted_servos
from firmware_bridge.dynamixel.provisioning import wanted_settings
from firmware_bridge.dynamixel.wire.codec import FrameParser, Instruction
from firmware_bridge.errors import PortGone
from firmware_bridge.simulator.chain import SimulatedChain, chain_for
from lipservo.cli import app
from lipservo.settings.settings import load_shipped_face

BAUD_RATE = 1_000_000
SERVOS = mounted_servos(load_shipped_face("face_four").wiring)
NAMES = [servo.joint.name for servo in SERVOS]
IDS = [servo.joint.servo_id for servo in SERVOS]
TORQUE = register("torque_enable").address


class Bench:
    """Servos on a table and the command that sets them up; `sent` keeps every packet."""

    def __init__(self, monkeypatch, chain, seed=0, **disturbances):
        self.chain, self.clock, self.sent = chain, ManualClock(), []
        self.seed, self.disturbances = seed, disturbances
        self.before_write = lambda *_: None
        monkeypatch.setattr(
            "firmware_bridge.serial_servos.provisioning.open_port", lambda *_: self.open()
        )

    def open(self):
        rng = random.Random(self.seed)
        by = Disturbance(**self.disturbances)
        port = DisturbedTransport(self.chain, self.clock, rng, by, sent=self.sent)
        write = port.write

        def watched(data):
            for frame in FrameParser().feed(data):
                if frame.instruction == Instruction.WRITE:
                    self.before_write(frame.parameters[0], frame.parameters[2:])
            write(data)

        port.write = watched
        return port

    def run(self, *arguments, **options):
        command = ["setup-servos", *arguments, "--config", "face_four", "--port", "here"]
        return CliRunner().invoke(app, command, **options)

    def writes(self):
        """Registers written, as (id, address, bytes), torque off left out."""
        frames = [frame for data in self.sent for frame in FrameParser().feed(data)]
        assert not any(frame.instruction == Instruction.SYNC_WRITE for frame in frames)
        found = [
            (frame.packet_id, frame.parameters[0], frame.parameters[2:])
            for frame in frames
            if frame.instruction == Instruction.WRITE
        ]
        assert not any(at <= TORQUE < at + len(data) and any(data) for _, at, data in found)
        return [each for each in found if each[1] != TORQUE]

    def lacking(self):
        """Joint and register of everything that is not as the YAML wants it."""
        return [
            (servo.joint.name, name)
            for servo, simulated in zip(SERVOS, self.chain.servos, strict=True)
            for name, value in wanted_settings(servo, BAUD_RATE).items()
            if simulated[name] != value
        ]


@pytest.fixture
def wired(monkeypatch):
    """The whole face, rightly numbered; two joints got other limits, one a return delay."""
    bench = Bench(monkeypatch, chain_for(SERVOS, BAUD_RATE))
    spoil(bench.chain)
    return bench


def spoil(chain):
    for index, name, value in ((0, "max_position_limit", 2100), (2, "min_position_limit", 2000),
                               (2, "return_delay_time", 250)):  # fmt: skip
        chain.servos[index][name] = value


def test_a_wired_chain_gets_what_differs_and_nobody_is_unplugged(wired):
    wired.chain.servos[0].write(bytes((TORQUE, 0, 1)))
    done = wired.run()

    assert done.exit_code == 0, done.output
    assert wired.lacking() == []
    assert not wired.chain.servos[0].torque_on
    names = ("max_position_limit", "return_delay_time", "min_position_limit")
    addresses = [register(name).address for name in names]
    written = [(IDS[0], addresses[0]), (IDS[2], addresses[1]), (IDS[2], addresses[2])]
    assert [(each[0], each[1]) for each in wired.writes()] == written
    assert f"{NAMES[0]}: max_position_limit 2100 -> " in done.stdout
    assert f"{NAMES[3]}: set up as id {IDS[3]}" in done.stdout


def test_a_chain_that_is_set_up_is_not_written_to_at_all(monkeypatch):
    bench = Bench(monkeypatch, chain_for(SERVOS, BAUD_RATE))

    assert bench.run().exit_code == 0
    assert not any(data[7] == Instruction.WRITE for data in bench.sent)


def test_one_joint_of_a_wired_chain_can_be_named(wired):
    assert wired.run(NAMES[2]).exit_code == 0
    assert wired.lacking() == [(NAMES[0], "max_position_limit")]


def test_a_dry_run_lists_and_writes_nothing(wired):
    before = wired.lacking()
    done = wired.run("--dry-run")

    assert done.exit_code == 0
    assert f"{NAMES[0]}: max_position_limit 2100 -> " in done.stdout
    assert "(not written)" in done.stdout
    assert wired.lacking() == before
    assert not any(data[7] == Instruction.WRITE for data in wired.sent)


def test_json_says_what_was_found_wanted_and_set(wired):
    said = json.loads(wired.run("--json").stdout)

    assert (said["complete"], said["dry_run"], said["error"]) == (True, False, "")
    assert [each["joint"] for each in said["servos"]] == NAMES
    (change,) = said["servos"][0]["changes"]
    assert change["register"] == "max_position_limit"
    assert (change["found"], change["set"]) == (2100, True)


def test_a_chain_at_its_old_rate_is_brought_to_the_new_one(monkeypatch):
    bench = Bench(monkeypatch, chain_for(SERVOS, 57_600))
    done = bench.run()

    assert done.exit_code == 0, done.output
    assert bench.lacking() == []


def test_a_fresh_servo_alone_becomes_the_joint(monkeypatch):
    chain = SimulatedChain([SERVOS[1].model], [1])
    bench = Bench(monkeypatch, chain)
    done = bench.run(NAMES[1])

    assert done.exit_code == 0, done.output
    assert (chain.servos[0].servo_id, chain.servos[0].baud_rate) == (IDS[1], BAUD_RATE)
    bench.writes()


def test_without_joints_and_with_nobody_there_it_asks_for_one_after_another(monkeypatch):
    bench = Bench(monkeypatch, SimulatedChain([SERVOS[0].model], [1]))
    done = bench.run(input="\n")

    assert f"Connect the servo of {NAMES[0]!r} alone" in done.stderr
    assert f"{NAMES[0]}: set up as id {IDS[0]}" in done.stdout


def test_a_servo_that_was_not_exchanged_is_not_renumbered_as_the_next_joint(monkeypatch):
    chain = SimulatedChain([SERVOS[0].model], [1])
    done = Bench(monkeypatch, chain).run(input="\n\n\n\n")

    assert done.exit_code == 1
    assert done.stderr.count(f"this is the servo of {NAMES[0]!r}, set up just now") == 3
    assert f"{NAMES[1]}: not reached" in done.stderr
    assert chain.servos[0].servo_id == IDS[0]


@pytest.mark.parametrize("joints", [(), (NAMES[1],)])
def test_two_new_servos_connected_together_are_told_apart_from_none(monkeypatch, joints):
    """Both have id 1: what one answers spoils what the other does."""
    chain = SimulatedChain([SERVOS[0].model] * 2, [1, 1])
    chain.motors.position[1] += 100
    done = Bench(monkeypatch, chain).run(*joints, input="\n")

    assert done.exit_code == 1
    assert "two servos answer to id 1: connect the servo of " in done.stderr


def mixed(n_fresh_id, rate):
    """The face, whose last servo was replaced by a new one."""
    chain = chain_for(SERVOS, BAUD_RATE)
    chain.servos[3]["id"] = n_fresh_id
    chain.servos[3]["baud_rate"] = {57_600: 1, BAUD_RATE: 3}[rate]
    return chain


@pytest.mark.parametrize(
    ("fresh_id", "rate", "said"),
    [
        (IDS[0], 57_600, f"4 servos answer (ids [{IDS[0]}, {IDS[0]}, "),
        (1, 57_600, "4 servos answer"),
        (1, BAUD_RATE, "4 servos answer"),
        (IDS[0], BAUD_RATE, "2 servos answer"),
    ],
)
@pytest.mark.parametrize("named", [False, True])
def test_a_new_servo_among_the_others_is_refused_in_one_line(
    monkeypatch, fresh_id, rate, said, named
):
    bench = Bench(monkeypatch, mixed(fresh_id, rate))
    done = bench.run(*([NAMES[0], NAMES[3]] if named else []))
    (line,) = done.stderr.splitlines()

    assert done.exit_code == 1
    assert said in line
    assert "alone and run `lipservo setup-servos" in line
    assert not any(data[7] == Instruction.WRITE for data in bench.sent)


def test_a_new_servo_that_has_the_id_of_another_is_not_overlooked(monkeypatch):
    models = [servo.model for servo in SERVOS]
    chain = SimulatedChain([*models, models[0]], [*IDS, IDS[1]], baud_rate=BAUD_RATE)
    chain.servos[4]["baud_rate"] = 1
    done = Bench(monkeypatch, chain).run()

    assert done.exit_code == 1
    assert f"{NAMES[1]}: id {IDS[1]} answers at 1,000,000 and at 57,600 baud" in done.stderr


def test_a_servo_of_another_model_is_refused(wired):
    wired.chain.servos[1]["model_number"] = 1190
    done = wired.run()

    assert done.exit_code == 1
    assert f"the servo found for {NAMES[1]!r} is XL330-M077" in done.stderr
    assert wired.writes() == []


def test_nobody_there_is_said_in_one_line(monkeypatch):
    bench = Bench(monkeypatch, SimulatedChain([SERVOS[0].model], [1]), lost=1.0)
    done = bench.run(NAMES[0])

    assert done.exit_code == 1
    assert done.stderr == "lipservo: no servo answers at any baud rate; check its power and cable\n"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT])
def test_a_signal_lets_the_register_be_finished_and_says_what_is_left(wired, number):
    def interrupt(address, _):
        if address == register("return_delay_time").address:
            signal.raise_signal(number)

    wired.before_write = interrupt
    before = signal.getsignal(number)
    done = wired.run()
    (line,) = done.stderr.splitlines()

    assert done.exit_code == 128 + number
    assert wired.lacking() == [(NAMES[2], "min_position_limit")]
    assert f"stopped by {number.name}; set: {NAMES[0]}: max_position_limit 2100 -> " in line
    assert f"not set: {NAMES[2]}: min_position_limit 2000 -> " in line
    assert signal.getsignal(number) == before
    wired.writes()


def test_a_signal_while_it_looks_around_ends_it_at_once(wired):
    wired.before_write = lambda *_: pytest.fail("nothing may be written")
    original = wired.open

    def interrupted():
        signal.raise_signal(signal.SIGTERM)
        return original()

    wired.open = interrupted

    assert wired.run().exit_code == 128 + signal.SIGTERM


def test_a_port_that_vanishes_midway_says_what_is_left_in_one_line(wired):
    def pull(address, _):
        if address == register("return_delay_time").address:
            raise PortGone("here: gone; plug the adapter in again")

    wired.before_write = pull
    done = wired.run()
    (line,) = done.stderr.splitlines()

    assert done.exit_code == 1
    assert "here: gone" in line
    assert f"not set: {NAMES[2]}: return_delay_time 250 -> 0, {NAMES[2]}: min_position" in line


@pytest.mark.parametrize("seed", range(3))
def test_late_replies_an_echo_and_noise_change_nothing_of_what_is_written(monkeypatch, seed):
    bench = Bench(
        monkeypatch, chain_for(SERVOS, BAUD_RATE), seed,
        late=0.1, echo=True, fast_sync_read=False, stray=0.2,
    )  # fmt: skip
    spoil(bench.chain)
    done = bench.run()

    assert done.exit_code == 0, done.output
    assert bench.lacking() == []
    assert len(set(bench.writes())) == 3


def test_input_that_ends_midway_leaves_the_report_of_what_was_set(monkeypatch):
    """The first servo was written before the second was asked for."""
    said = {}
    for how in ((), ("--json",)):
        chain = SimulatedChain([SERVOS[0].model], [1])
        bench = Bench(monkeypatch, chain)
        said[how] = bench.run(*how, input="\n")
        assert said[how].exit_code == 1
        assert chain.servos[0].servo_id == IDS[0]
        assert bench.writes()
    told = json.loads(said["--json",].stdout)
    line = said[()].stderr.splitlines()[-1]

    assert (told["complete"], told["dry_run"]) == (False, False)
    assert "the input ended before each was connected alone" in told["error"]
    (servo,) = told["servos"]
    assert (servo["joint"], servo["found_id"], servo["id"]) == (NAMES[0], 1, IDS[0])
    assert {each["set"] for each in servo["changes"]} == {True}
    assert f"; set: {NAMES[0]}: id 1 -> {IDS[0]}, " in line
    left = ", ".join(f"{name}: not reached" for name in NAMES[1:])
    assert line.endswith(f"not set: {left}; torque is off where anything was set")
