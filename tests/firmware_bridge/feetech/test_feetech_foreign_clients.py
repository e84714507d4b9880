"""Programs that this project did not write, unmodified, on the port of `sim-bus --kind feetech`."""

import time

import pytest

from firmware_bridge.feetech.control_table import servo_models
from lipservo.runtime.servos.sim_process import simulated_port

RATE = 1_000_000
IDS = [1, 2, 3]
CLIENTS = {"STS3215": "Sts3215PyController", "SCS0009": "Scs0009PyController"}


@pytest.fixture(scope="module")
def sts_port():
    with simulated_port(["--kind", "feetech", "--servos", str(len(IDS)), "--on-time"]) as port:
        yield port


@pytest.fixture(scope="module")
def scs_port():
    arguments = ["--kind", "feetech", "--servos", "3", "--model", "SCS0009", "--on-time"]
    with simulated_port(arguments) as port:
        yield port


def until(reached):
    """Ask again until it is so: motion takes its time, and computers are busy."""
    for _ in range(300):
        if reached():
            return True
        time.sleep(0.01)
    return False


@pytest.fixture
def rustypot(request):
    """Its client of one model, at the port of a chain of these."""
    module = pytest.importorskip("rustypot", exc_type=ImportError)
    port = request.getfixturevalue({"STS3215": "sts_port", "SCS0009": "scs_port"}[request.param])
    client = getattr(module, CLIENTS[request.param])(serial_port=port, baudrate=RATE, timeout=0.5)
    yield client
    client.close()


@pytest.mark.parametrize("rustypot", CLIENTS, indirect=True)
def test_rustypot_moves_a_servo_of_either_dialect(rustypot):
    assert rustypot.ping(2)
    assert not rustypot.ping(77)
    rustypot.write_torque_enable(2, True)
    rustypot.write_goal_position(2, 0.3)
    assert until(lambda: abs(rustypot.read_present_position(2)[0] - 0.3) < 0.01)
    assert rustypot.read_present_temperature(2) == [25]


@pytest.mark.parametrize("rustypot", ["STS3215"], indirect=True)
def test_rustypot_asks_all_in_one_question(rustypot):
    rustypot.sync_write_raw_goal_position(IDS, [2001, 2002, 2003])

    assert until(lambda: rustypot.sync_read_raw_present_position(IDS) == [2001, 2002, 2003])


@pytest.mark.parametrize("model", CLIENTS)
def test_rustypot_has_the_same_registers(model):
    module = pytest.importorskip("rustypot", exc_type=ImportError)
    theirs = {each.name: each for each in getattr(module, CLIENTS[model]).registers()}
    names = {
        "max_temperature": "max_temperature_limit",
        "max_voltage": "max_voltage_limit",
        "min_voltage": "min_voltage_limit",
        "max_torque": "max_torque_limit",
    }
    compared = 0
    for name, entry in servo_models()[model].dialect.registers.items():
        other = theirs.get(names.get(name, name))
        if other is not None:
            assert (entry.address, entry.size) == (other.addr, other.size), name
            compared += 1
    assert compared > 20


@pytest.fixture
def sdk(sts_port):
    """ftservo-python-sdk, where it is installed: it shares its name with an older one."""
    module = pytest.importorskip("scservo_sdk", reason="ftservo-python-sdk is not installed")
    if not hasattr(module, "sms_sts"):
        pytest.skip("another scservo_sdk is installed, not ftservo-python-sdk")
    handler = module.PortHandler(sts_port)
    assert handler.openPort()
    yield module, module.sms_sts(handler)
    handler.closePort()


def test_the_vendors_library_moves_servos_without_switching_torque_on(sdk, monkeypatch):
    module, servos = sdk
    monkeypatch.setattr("scservo_sdk.port_handler.LATENCY_TIMER", 250)
    assert servos.ping(3)[:2] == (777, module.COMM_SUCCESS)
    assert servos.WritePosEx(3, 2300, 2400, 50) == (module.COMM_SUCCESS, 0)
    assert until(lambda: servos.ReadPos(3)[0] == 2300)
    assert servos.read1ByteTxRx(3, 40)[0] == 1

    read = module.GroupSyncRead(servos, 56, 4)
    for servo_id in IDS:
        read.addParam(servo_id)
    assert read.txRxPacket() == module.COMM_SUCCESS
    assert read.getData(3, 56, 2) == 2300
