"""What every bus and every line keeps to, whoever makes its packets and whatever carries them."""

import contextlib
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from feetech_chain import on_feetech
from hobby_bus import PULSES, on_maestro, on_pca9685

from firmware_bridge.capabilities import IN_MEMORY
from firmware_bridge.clock import ManualClock, MonotonicClock
from firmware_bridge.dynamixel.bus import DynamixelBus
from firmware_bridge.dynamixel.mounting import mounted_servos
from firmware_bridge.dynamixel.wire.codec import SpanRead
from firmware_bridge.dynamixel.wire.line import Line
from firmware_bridge.dynamixel.wire.sdk_line import SdkLine, SdkTransport
from firmware_bridge.errors import PortError, PortGone
from firmware_bridge.known_torque import Torque
from firmware_bridge.maestro.kind import MAESTRO
from firmware_bridge.maestro.simulator import simulated_wire as simulated_maestro
from firmware_bridge.pca9685.simulator import MemoryTransfers
from firmware_bridge.serial_servos.serial_transport import open_port
from firmware_bridge.several_buses import SeveralBuses
from firmware_bridge.simulator.bus import SimulatedBus
from firmware_bridge.simulator.chain import chain_for
from firmware_bridge.simulator.ports import MemoryTransport
from lipservo.runtime.servos.assembly import bus_for, simulated_wire
from lipservo.runtime.servos.sim_process import simulated_port
from lipservo.settings.settings import load_shipped_face, parse_face

BAUD_RATE = 1_000_000
FACE = load_shipped_face("face_four")
SERVOS = mounted_servos(FACE.wiring)
IDS = [servo.joint.servo_id for servo in SERVOS]
N = len(SERVOS)
#: Far more than anything here takes, even on a busy machine.
TIMEOUT_S = 60.0
#: Half a step of the coarsest encoder, an SCS0009's.
STEP_DEG = 0.15
MAKERS = {"own": (open_port, Line), "sdk": (SdkTransport, SdkLine)}


@pytest.fixture(scope="module")
def port():
    with simulated_port(["--config", "face_four", "--on-time"]) as port:
        yield port


@pytest.fixture(scope="module")
def maestro_port():
    with simulated_port(["--kind", "maestro", "--on-time"]) as port:
        yield port


@pytest.fixture(scope="module")
def pca9685_port(tmp_path_factory):
    config = tmp_path_factory.mktemp("pca9685") / "face.yaml"
    config.write_text(on_pca9685(FACE))
    with simulated_port(["--config", str(config), "--on-time"]) as port:
        yield port


@pytest.fixture(scope="module")
def feetech_port(tmp_path_factory):
    config = tmp_path_factory.mktemp("feetech") / "face.yaml"
    config.write_text(on_feetech(FACE))
    with simulated_port(["--config", str(config), "--on-time"]) as port:
        yield port


@pytest.fixture(autouse=True)
def long_timeouts(monkeypatch):
    """The SDK waits for 34 ms; a computer that runs other tests meanwhile may need more."""
    monkeypatch.setattr("dynamixel_sdk.port_handler.LATENCY_TIMER", 100)


def eventually(condition, clock, period_s=0.02):
    """Real lines lose a sample when the computer is busy: ask again, as the bridge does."""
    give_up_s = time.monotonic() + TIMEOUT_S
    while not condition():
        assert time.monotonic() < give_up_s, "it never came true"
        clock.sleep_until(clock.now() + period_s)
    return True


BUSES = ["simulated", "pulses", "maestro", "pca9685", "feetech", "scs", "memory", "several"]
#: A part of a tick at this rate is more than a busy computer keeps a thread waiting.
SLOW_HZ = 1.0


def on_two_buses(ports=None):
    """The joints of the face in turns on a chain and on a Maestro; ports: of each."""
    of = {"neck": [0, 2], "lips": [1, 3]}
    bus_of = ["neck", "lips", "neck", "lips"]
    if ports is None:
        clock = ManualClock()
        can = {"neck": IN_MEMORY, "lips": PULSES}
        buses = {
            name: SimulatedBus([FACE.joints()[n] for n in of[name]], clock, capabilities=can[name])
            for name in of
        }
        return SeveralBuses(buses, bus_of, clock, SLOW_HZ), clock
    clock = MonotonicClock()
    neck = DynamixelBus(
        [SERVOS[n] for n in of["neck"]], lambda: open_port(ports["neck"], BAUD_RATE), watchdog_s=0.0
    )
    pulses = on_maestro(FACE, port=ports["lips"])
    lips = MAESTRO.open(
        replace(
            pulses,
            joints=tuple(pulses.joints[n] for n in of["lips"]),
            servos=tuple(pulses.servos[n] for n in of["lips"]),
        ),
        clock,
    )
    return SeveralBuses({"neck": neck, "lips": lips}, bus_of, clock, SLOW_HZ), clock


AT_PTYS = ["maestro pty", "pca9685 pty", "feetech pty", "own", "sdk", "several pty"]


@pytest.fixture(params=[*BUSES, *AT_PTYS])
def face(request):
    """A bus that is not entered yet, its clock, and how its servos are seen from outside."""
    clock = ManualClock() if request.param in BUSES else MonotonicClock()
    if request.param == "simulated":
        bus = SimulatedBus(FACE.joints(), clock)
    elif request.param == "pulses":
        bus = SimulatedBus(FACE.joints(), clock, capabilities=PULSES)
    elif request.param == "several":
        bus, clock = on_two_buses()
    elif request.param == "several pty":
        ports = {
            "neck": request.getfixturevalue("port"), "lips": request.getfixturevalue("maestro_port")
        }  # fmt: skip
        bus, clock = on_two_buses(ports)
    elif request.param == "maestro":
        bus, clock = simulated_maestro(on_maestro(FACE))
    elif request.param == "maestro pty":
        port = request.getfixturevalue("maestro_port")
        bus = MAESTRO.open(on_maestro(FACE, port=port), clock)
    elif request.param == "pca9685":
        bus, clock = simulated_wire(parse_face(on_pca9685(FACE), "face.yaml"))
    elif request.param == "pca9685 pty":
        port = request.getfixturevalue("pca9685_port")
        bus = bus_for(parse_face(on_pca9685(FACE), "face.yaml").at_port(port), clock)
    elif request.param in ("feetech", "scs"):
        model = {"feetech": "STS3215", "scs": "SCS0009"}[request.param]
        bus, clock = simulated_wire(parse_face(on_feetech(FACE, model), "face.yaml"))
    elif request.param == "feetech pty":
        port = request.getfixturevalue("feetech_port")
        bus = bus_for(parse_face(on_feetech(FACE), "face.yaml").at_port(port), clock)
    elif request.param == "memory":
        chain = chain_for(SERVOS, BAUD_RATE)
        bus = DynamixelBus(SERVOS, lambda: MemoryTransport(chain, clock, BAUD_RATE), watchdog_s=0.0)
    else:
        open_transport, make_line = MAKERS[request.param]
        path = request.getfixturevalue("port")
        bus = DynamixelBus(
            SERVOS, lambda: open_transport(path, BAUD_RATE), make_line=make_line, watchdog_s=0.0
        )
    return SimpleNamespace(bus=bus, clock=clock, name=request.param)


def hold(face):
    """As a start does: one after another, again where a busy computer lost an answer."""
    for index in range(N):
        eventually(lambda index=index: not face.bus.enable_torque(index), face.clock)


#: The goals of a face that stays where it is.
AT_REST = np.zeros(N)


def known(face, goal_deg=None):
    """What the bus knows of torque once servos have been asked, with a goal sent before if any."""
    if goal_deg is not None:
        face.bus.write_positions(goal_deg)
    face.bus.read()
    return face.bus.torque.as_json()


def test_a_bus_just_entered_is_limp_and_says_where_everybody_stands(face):
    with face.bus as bus:
        assert eventually(lambda: not bus.read().missing.any(), face.clock)
        readings = bus.read()

        assert readings.positions_deg.shape == (N,)
        has_place = [bus.capabilities.of(n).place for n in range(N)]
        assert np.isfinite(readings.positions_deg).tolist() == has_place
        assert readings.torque.tolist() == [Torque.OFF] * N


def test_what_a_bus_can_do_is_known_before_its_port_is_open(face):
    can = face.bus.capabilities
    is_simulated = isinstance(face.bus, SimulatedBus) or face.name == "several"
    has_way_back = can.pulse_rate_hz is None

    assert can.hold
    assert {can.place, can.load, can.heat, can.voltage, can.confirmed_limp} == {has_way_back}
    assert {can.memory, can.set_up} == {not is_simulated and has_way_back}
    assert can.watchdog is (can.memory and not face.name.startswith(("feetech", "scs")))
    assert can.profile is not (is_simulated or face.name.startswith("pca9685"))
    assert (can.soft_start_s > 0.0) is not is_simulated
    assert (can.released_words == "limp") is can.confirmed_limp


def test_what_a_bus_cannot_measure_is_not_a_number(face):
    with face.bus as bus:
        blind = [n for n in range(N) if not bus.capabilities.of(n).heat]
        if not blind:
            pytest.skip("measures everything")
        places_deg, health = bus.feedback().positions_deg, bus.look_after()

        assert np.isnan(places_deg[blind]).all()
        told = np.array([health.temperature_degc, health.voltage_v, health.effort])
        assert np.isnan(told[:, blind]).all()
        assert (health.room_degc[blind] == np.inf).all()


def test_a_servo_that_confirms_that_it_is_limp_or_cannot_counts_as_let_go(face):
    with face.bus as bus:
        eventually(lambda: not bus.enable_torque(0), face.clock)

        assert eventually(lambda: bus.disable_torque(0), face.clock)
        assert eventually(lambda: bus.disable_all().all(), face.clock)


def test_outside_its_block_a_bus_is_closed(face):
    with pytest.raises(PortError):
        face.bus.read()
    with face.bus:
        pass
    with pytest.raises(PortError):
        face.bus.feedback()


def test_goals_are_reached_and_leaving_lets_go(face):
    goal_deg = np.array([3.0, -2.0, 4.0, -5.0])
    with face.bus as bus:
        hold(face)
        bus.write_positions(goal_deg)

        def arrived():
            return np.nanmax(np.abs(bus.feedback().positions_deg - goal_deg), initial=0.0) < 0.3

        assert eventually(arrived, face.clock)
        assert eventually(
            lambda: np.abs(bus.read().goals_deg - goal_deg).max() < STEP_DEG, face.clock
        )
        assert eventually(lambda: known(face, goal_deg) == [True] * N, face.clock)
    with face.bus as bus:
        assert eventually(lambda: not bus.read().missing.any(), face.clock)
        assert known(face) == [False] * N


@pytest.mark.parametrize("invalid", [np.nan, np.inf, 90.0])
def test_a_goal_that_is_invalid_is_kept_from_its_servo_and_noted(face, invalid):
    with face.bus as bus:
        bus.write_positions(np.zeros(N))
        bus.write_positions(np.array([1.0, invalid, 1.0, 1.0]))
        readings = bus.read()

        assert eventually(lambda: np.isfinite(bus.read().goals_deg).all(), face.clock)
        np.testing.assert_allclose(bus.read().goals_deg, [1.0, 0.0, 1.0, 1.0], atol=STEP_DEG)
        assert (readings.errors != 0).tolist() == [False, True, False, False]


@pytest.mark.parametrize("shape", [(N - 1,), (N + 1,), (N, 1), ()])
def test_goals_of_the_wrong_shape_are_refused(face, shape):
    with face.bus as bus, pytest.raises(ValueError, match="expected positions of shape"):
        bus.write_positions(np.zeros(shape))


def test_servos_get_torque_are_let_go_and_restarted_one_by_one(face):
    with face.bus as bus:
        eventually(lambda: not bus.enable_torque(1), face.clock)
        eventually(lambda: not bus.enable_torque(2), face.clock)
        assert eventually(lambda: known(face, AT_REST) == [False, True, True, False], face.clock)
        eventually(lambda: bus.disable_torque(1), face.clock)
        bus.reboot(2)
        bus.forgive(2)
        assert eventually(lambda: known(face) == [False] * N, face.clock)
        assert eventually(lambda: not bus.feedback().age_s.any(), face.clock)


def test_torque_is_unknown_before_any_evidence(face):
    assert face.bus.torque.as_json() == [None] * N
    assert face.bus.torque.any_on is None
    assert np.isneginf(face.bus.torque.at_s).all()


def test_torque_that_goes_off_everywhere_is_known_to_be_off_from_then_on(face):
    with face.bus as bus:
        hold(face)
        eventually(lambda: known(face, AT_REST) == [True] * N, face.clock)
        before_s = face.clock.now()

        assert bus.torque.any_on
        assert eventually(lambda: bus.disable_all().all(), face.clock)
        assert (bus.torque.at_s >= before_s).all()
        assert bus.torque.any_on is False


#: Those at a transport in memory, which can be cut.
AT_MEMORY = ["maestro", "feetech", "scs", "memory"]
on_memory = pytest.mark.parametrize("face", AT_MEMORY, indirect=True)


def tick(face):
    face.clock.advance(0.02)
    face.bus.write_positions(AT_REST)
    face.bus.feedback()
    face.bus.look_after()


def held(face, stack):
    """The bus, entered, with every servo on and caught up."""
    bus = stack.enter_context(face.bus)
    hold(face)
    for _ in range(150):
        tick(face)
    assert bus.torque.as_json() == [True] * N
    return bus


def deaf(transport, deadline_s):
    transport.clock.sleep_until(deadline_s)
    return b""


@on_memory
def test_half_a_second_after_the_last_answer_torque_is_unknown(face, monkeypatch):
    with contextlib.ExitStack() as stack:
        bus = held(face, stack)
        monkeypatch.setattr(MemoryTransport, "read", deaf)
        silent_s = face.clock.now()
        seen = []
        while face.clock.now() < silent_s + 1.0:
            tick(face)
            seen.append((face.clock.now() - silent_s, bus.torque.any_on))
        known_until_s = max(time_s for time_s, any_on in seen if any_on)
        monkeypatch.undo()

        assert 0.3 < known_until_s < 0.7
        assert bus.torque.as_json() == [None] * N
        assert eventually(lambda: tick(face) or bus.torque.as_json() == [True] * N, face.clock)


@on_memory
def test_a_torque_that_was_ordered_off_is_unknown_until_that_is_confirmed(face, monkeypatch):
    with contextlib.ExitStack() as stack:
        bus = held(face, stack)
        monkeypatch.setattr(MemoryTransport, "read", deaf)

        assert not bus.disable_torque(1)
        assert bus.torque.as_json() == [True, None, True, True]
        assert not bus.disable_all().any()
        assert bus.torque.as_json() == [None] * N


@on_memory
def test_a_torque_that_was_ordered_on_is_unknown_until_that_is_confirmed(face, monkeypatch):
    with face.bus as bus:
        assert known(face) == [False] * N
        seen = []
        write = MemoryTransport.write

        def watched(transport, data):
            seen.append(bus.torque.as_json()[0])
            write(transport, data)

        monkeypatch.setattr(MemoryTransport, "write", watched)
        bus.enable_torque(0)

        assert set(seen) <= {False, None}
        assert seen[-1] is None
        assert bus.torque.as_json()[0] is True


#: Calls that send something, by name; of hobby servos neither their feedback nor a second start.
USES = {
    "write": lambda bus: bus.write_positions(AT_REST),
    "look": lambda bus: bus.look_after(),
    "disable": lambda bus: bus.disable_torque(0),
    "disable all": lambda bus: bus.disable_all(),
    "feedback": lambda bus: bus.feedback(),
    "enable": lambda bus: bus.enable_torque(0),
    "keep": lambda bus: bus.keep_torque(0),
    "obstacle": lambda bus: bus.obstacle(0),
    "read": lambda bus: bus.read(),
}


@pytest.mark.parametrize(
    ("face", "use"),
    [
        *[(name, use) for name in ("maestro", "pca9685") for use in list(USES)[:4]],
        *[(name, use) for name in ("memory", "feetech", "scs") for use in USES],
    ],
    indirect=["face"],
)
def test_a_lost_port_makes_every_torque_unknown(face, use, monkeypatch):
    def gone(*_):
        raise PortGone("gone")

    with contextlib.ExitStack() as stack:
        bus = held(face, stack)
        face.clock.advance(0.3)  # a look is due
        for transport, method in (
            (MemoryTransport, "write"), (MemoryTransport, "discard_input"),
            (MemoryTransfers, "transfer"),
        ):  # fmt: skip
            monkeypatch.setattr(transport, method, gone)
        with pytest.raises(PortGone):
            USES[use](bus)
        monkeypatch.undo()

        assert bus.torque.as_json() == [None] * N


def test_a_port_that_was_opened_again_makes_torque_unknown_until_servos_are_asked(face):
    with face.bus as bus:
        hold(face)
        eventually(lambda: known(face, AT_REST) == [True] * N, face.clock)
        bus.reopen()
        if face.name in BUSES and face.name not in ("several", "maestro", "pca9685"):
            assert bus.torque.as_json() == [None] * N
        assert eventually(lambda: known(face) == [True] * N, face.clock)


def test_health_is_known_after_a_round(face):
    with face.bus as bus:
        if not bus.capabilities.heat:
            pytest.skip("measures nothing")

        def known():
            return np.isfinite(bus.look_after().voltage_v).all()

        assert eventually(known, face.clock)
        health = bus.look_after()

        assert (health.voltage_v > 3.0).all()
        assert (health.room_degc > 10.0).all()
        assert not health.hardware_errors.any()


def test_a_bus_may_be_opened_again(face):
    with face.bus as bus:
        bus.reopen()

        assert eventually(lambda: not bus.feedback().age_s.any(), face.clock)


@pytest.mark.parametrize("maker", MAKERS)
def test_a_plug_that_is_pulled_is_noticed_and_the_bus_comes_back(maker, tmp_path):
    """The SDK raises three kinds of exception for it, and stays marked as busy."""
    open_transport, make_line = MAKERS[maker]
    script, link = tmp_path / "faults.yaml", tmp_path / "port"
    script.write_text("faults: [{kind: unplug, every_s: 3.0, lasts_s: 0.5}]")
    arguments = ["--config", "face_four", "--link", str(link), "--faults", str(script)]
    with simulated_port([*arguments, "--on-time"]) as path, contextlib.ExitStack() as stack:
        bus = DynamixelBus(
            SERVOS, lambda: open_transport(path, BAUD_RATE), make_line=make_line, strict=False
        )

        def is_(act):
            with contextlib.suppress(PortError):
                act()
                return True

        clock = MonotonicClock()
        eventually(lambda: is_(lambda: stack.enter_context(bus)), clock)
        gone = []

        def pulled():
            try:
                bus.feedback()
            except PortGone as error:
                gone.append(error)
            return gone

        eventually(pulled, clock, period_s=0.005)
        assert "plug the adapter in again" in str(gone[0])
        eventually(lambda: is_(bus.reopen), clock)
        assert eventually(lambda: is_(lambda: not bus.feedback().age_s.any()), clock)


@pytest.fixture(params=["memory", "own", "sdk"])
def line(request):
    """A line to the same servos, in memory or over a terminal."""
    if request.param == "memory":
        transport = MemoryTransport(chain_for(SERVOS, BAUD_RATE), ManualClock(), BAUD_RATE)
        make_line = Line
    else:
        open_transport, make_line = MAKERS[request.param]
        transport = open_transport(request.getfixturevalue("port"), BAUD_RATE)
    yield make_line(transport)
    transport.close()


def answer(ask, line):
    """What a question is answered with, asked again while nothing comes."""
    found = []
    eventually(lambda: found.append(ask()) or found[-1], line.transport.clock)
    return found[-1]


def test_a_ping_tells_the_model_and_nobody_answers_to_a_strange_id(line):
    pong = answer(lambda: line.ping(IDS[0]), line)

    assert (pong.servo_id, pong.error, pong.data[:2]) == (IDS[0], 0, b"\xb0\x04")
    assert line.ping(200) is None
    assert [s.servo_id for s in answer(line.ping_all, line)] == IDS


#: More than any mode takes as a goal position: 2,000,000 pulses.
BEYOND = (2_000_000).to_bytes(4, "little")


def test_what_is_written_is_read_and_what_is_refused_says_why(line):
    assert answer(lambda: line.write(IDS[1], 65, b"\1"), line).error == 0
    assert answer(lambda: line.read(IDS[1], 65, 1), line).data == b"\1"
    assert answer(lambda: line.write(IDS[1], 65, b"\0"), line).error == 0
    assert answer(lambda: line.write(IDS[1], 132, bytes(4)), line).error == 7
    assert answer(lambda: line.write(IDS[1], 116, BEYOND), line).error == 6


def ids_heard(line, span):
    return [status.servo_id for status in line.sync_read(span) if len(status.data) == 10]


@pytest.mark.parametrize("fast", [False, True])
def test_everybody_answers_a_common_question(line, fast):
    span = SpanRead(IDS, 126, 10, fast=fast)

    assert eventually(lambda: ids_heard(line, span) == IDS, line.transport.clock)


def test_one_who_is_missing_costs_only_itself_or_with_the_sdk_everybody(line):
    """The SDK drops a whole group for one silent servo; that is why it is not the default."""
    span = SpanRead([IDS[0], 200, *IDS[1:]], 126, 10, fast=False)
    heard = [] if isinstance(line, SdkLine) else IDS

    assert eventually(lambda: ids_heard(line, span) == heard, line.transport.clock)


def test_a_restarted_servo_is_deaf_for_a_while_and_has_forgotten_its_ram(line):
    answer(lambda: line.write(IDS[3], 65, b"\1"), line)
    answer(lambda: line.reboot(IDS[3]), line)

    assert answer(lambda: line.read(IDS[3], 65, 1), line).data == b"\0"
