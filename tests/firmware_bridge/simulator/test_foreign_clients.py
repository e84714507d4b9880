"""Programs that this project did not write, unmodified, on the port of `lipservo sim-bus`.

Each finds the servos, switches torque on, moves, reads back, and uses what it has for groups.
"""

import importlib.util
import json
import sys
import time
import types

import pytest

from lipservo.runtime.servos.sim_process import simulated_port

BAUD_RATE = 1_000_000
IDS = [1, 2, 3]
TORQUE, PROFILE, GOAL, PLACE = 64, 112, 116, 132


@pytest.fixture(scope="module")
def port():
    arguments = ["--servos", str(len(IDS)), "--baud-rate", str(BAUD_RATE), "--on-time"]
    with simulated_port(arguments) as port:
        yield port


@pytest.fixture(autouse=True)
def long_timeouts(monkeypatch):
    """The SDK waits for 34 ms; a computer that runs other tests meanwhile may need more."""
    monkeypatch.setattr("dynamixel_sdk.port_handler.LATENCY_TIMER", 250)


def until(reached):
    """Ask again until it is so: motion takes its time, and computers are busy."""
    for _ in range(300):
        if reached():
            return True
        time.sleep(0.01)
    return False


@pytest.fixture
def sdk(port):
    import dynamixel_sdk

    handler = dynamixel_sdk.PortHandler(port)
    assert handler.openPort()
    assert handler.setBaudRate(BAUD_RATE)
    yield dynamixel_sdk, handler, dynamixel_sdk.PacketHandler(2.0)
    handler.closePort()


def test_dynamixel_sdk_moves_a_servo(sdk):
    _, handler, packets = sdk
    assert packets.ping(handler, 1) == (1200, 0, 0)
    assert packets.write1ByteTxRx(handler, 1, TORQUE, 1) == (0, 0)
    assert packets.write4ByteTxRx(handler, 1, GOAL, 2500) == (0, 0)

    assert until(lambda: packets.read4ByteTxRx(handler, 1, PLACE) == (2500, 0, 0))


@pytest.mark.parametrize("fast", [False, True])
def test_dynamixel_sdk_writes_and_reads_in_bulk(sdk, fast):
    module, handler, packets = sdk
    write = module.GroupBulkWrite(handler, packets)
    read = module.GroupBulkRead(handler, packets)
    for servo_id, address, size, value in ((1, GOAL, 4, 2222), (2, PROFILE, 4, 77), (3, 65, 1, 1)):
        write.addParam(servo_id, address, size, list(value.to_bytes(size, "little")))
        read.addParam(servo_id, address, size)

    assert write.txPacket() == 0
    assert (read.fastBulkRead() if fast else read.txRxPacket()) == 0
    assert read.getData(1, GOAL, 4) == 2222
    assert read.getData(2, PROFILE, 4) == 77
    assert read.getData(3, 65, 1) == 1


def test_dynamixel_sdk_registers_writes_and_lets_them_act(sdk):
    _, handler, packets = sdk
    for servo_id in IDS:
        goal = list((1900 + servo_id).to_bytes(4, "little"))
        assert packets.regWriteTxRx(handler, servo_id, GOAL, 4, goal) == (0, 0)
        assert packets.read1ByteTxRx(handler, servo_id, 69) == (1, 0, 0)

    assert packets.action(handler, 254) == 0
    assert [packets.read4ByteTxRx(handler, n, GOAL)[0] for n in IDS] == [1901, 1902, 1903]
    assert until(lambda: packets.read1ByteTxRx(handler, 1, 122)[0] == 0)  # at rest
    assert packets.clearMultiTurn(handler, 1) == (0, 0)


@pytest.fixture
def rustypot(port):
    module = pytest.importorskip("rustypot", exc_type=ImportError)
    client = module.Xl330PyController(serial_port=port, baudrate=BAUD_RATE, timeout=0.5)
    yield client
    client.close()


def test_rustypot_moves_servos(rustypot):
    """It sets its rate by TCSETS2, as every client on Rust's serialport does."""
    assert rustypot.ping(2)
    assert not rustypot.ping(77)
    rustypot.write_torque_enable(2, True)
    rustypot.write_raw_goal_position(2, 2300)
    assert until(lambda: rustypot.read_raw_present_position(2) == [2300])

    rustypot.sync_write_raw_torque_enable(IDS, [1, 1, 1])
    rustypot.sync_write_raw_goal_position(IDS, [2001, 2002, 2003])
    assert until(lambda: rustypot.sync_read_raw_present_position(IDS) == [2001, 2002, 2003])


def test_rustypot_reads_fast(rustypot):
    rustypot.set_fast_sync_read(True)
    rustypot.sync_write_raw_goal_position(IDS, [2011, 2012, 2013])

    assert rustypot.sync_read_raw_goal_position(IDS) == [2011, 2012, 2013]


def test_rustypot_at_the_wrong_rate_hears_nobody(port):
    module = pytest.importorskip("rustypot", exc_type=ImportError)
    client = module.Xl330PyController(serial_port=port, baudrate=115_200, timeout=0.05)
    try:
        assert not client.ping(1)
    finally:
        client.close()


@pytest.fixture
def lerobot(monkeypatch):
    """LeRobot's motors classes. Their package imports torch, of which they need nothing."""
    if importlib.util.find_spec("torch") is None:
        terminal = types.ModuleType("lerobot.utils.utils")
        for name in ("enter_pressed", "move_cursor_up"):  # for questions at a terminal
            setattr(terminal, name, None)
        monkeypatch.setitem(sys.modules, terminal.__name__, terminal)
    motors = pytest.importorskip("lerobot.motors", exc_type=ImportError)
    dynamixel = pytest.importorskip("lerobot.motors.dynamixel", exc_type=ImportError)
    return motors, dynamixel


@pytest.mark.filterwarnings("ignore")
def test_lerobot_moves_servos(lerobot, port):
    motors, dynamixel = lerobot
    names = {f"joint_{n}": motors.Motor(n, "xl330-m288", motors.MotorNormMode.DEGREES) for n in IDS}
    bus = dynamixel.DynamixelMotorsBus(port, names)
    bus.connect()  # which pings, and compares the models
    try:
        assert bus.broadcast_ping() == dict.fromkeys(IDS, 1200)
        bus.disable_torque()
        bus.configure_motors()
        for name in names:
            bus.write("Operating_Mode", name, dynamixel.OperatingMode.EXTENDED_POSITION.value)
        bus.enable_torque()
        goals = {"joint_1": 2048, "joint_2": 2600, "joint_3": 5000}
        bus.sync_write("Goal_Position", goals, normalize=False)
        assert until(lambda: bus.sync_read("Present_Position", normalize=False) == goals)
        assert bus.read("Present_Position", "joint_2", normalize=False) == 2600
    finally:
        for name in names:
            bus.write("Torque_Enable", name, 0)
            bus.write("Operating_Mode", name, dynamixel.OperatingMode.POSITION.value)
        bus.disconnect()


@pytest.mark.filterwarnings("ignore")
def test_dynio_moves_a_servo(port, tmp_path):
    """It has no groups, and a table in JSON for each model; here one for what is used."""
    module = pytest.importorskip("dynio.dynamixel_controller", exc_type=ImportError)
    table = tmp_path / "xl330.json"
    registers = {"Torque_Enable": [64, 1], "Goal_Position": [116, 4], "Present_Position": [132, 4]}
    table.write_text(json.dumps({"Protocol_2": {"Control_Table": registers, "Values": {}}}))
    bus = module.DynamixelIO(port, BAUD_RATE)
    try:
        motor = bus.new_motor(3, str(table), protocol=2)
        motor.torque_enable()
        motor.set_position(2345)

        assert until(lambda: motor.get_position() == 2345)
    finally:
        bus.port_handler.closePort()
