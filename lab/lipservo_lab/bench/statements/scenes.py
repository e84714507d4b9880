"""What a face and its commands are led through while all that they say is heard.

Each scene has a robot of its own. Together they bring a face into every state there is: starting,
driven, silent, easing, frozen, letting go, stopped, ended; with the port out, a mute controller or
servo, one switched off, failed or jammed, a dead or hung bridge, and with everybody dead.
"""

import contextlib
import os
import signal
import subprocess
from collections.abc import Callable
from typing import Final

from lipservo_lab.bench.statements.heard_face import HeardFace
from lipservo_lab.bench.stops.faces_on_buses import SERIAL
from lipservo_lab.bench.stops.robot_at_port import CLIP, kill_all

_DAEMON: Final = ("daemon", "--listen", "none")
#: Long enough that what is said in a state is said several times.
_STAYS_S: Final = 0.8
_OVERLOAD: Final = 0x20


def orders(face: HeardFace, bus: str) -> None:
    """Switch servos, stop, freeze and start a face on a healthy bus, by commands and requests.

    What the face and its commands say meanwhile is collected, to be checked afterwards.
    """
    daemon = face.begin_face(*_DAEMON)
    face.wait_until_driven()
    face.wait(_STAYS_S)
    name = face.last_servo
    for switch in ("off", "reboot", "on"):
        face.command("servo", name, switch)
        face.command("status")
    face.command("servo", "nobody", "off")
    face.command("stop", "--freeze")
    face.wait(_STAYS_S)
    face.command("status", "--json")
    face.command("stop", "--freeze")
    face.send("start")
    face.wait_until_driven()
    face.command("start")
    face.command("stop")
    face.wait_until_limp()
    face.command("status")
    face.command("stop", "--freeze")
    face.command("servo", name, "off")
    face.command("servo", name, "on", face_state="of a stopped face")
    face.command("start")
    face.send("soft", until_end=True)
    face.send("freeze")
    face.send("start")
    face.send("freeze")
    face.wait(_STAYS_S)
    face.send("start")
    face.wait_until_driven()
    face.send("limp", until_end=True)
    face.command("start", "--json")
    face.command("stop", "--json")
    face.command("doctor", "--config", face.robot.config, "--port", str(face.robot.port))
    face.command("health")
    face.command("health", "--json")
    daemon.send_signal(signal.SIGTERM)
    face.wait_exit(daemon, _name(_DAEMON))
    if bus not in SERIAL:
        return
    face.command("doctor", "--config", face.robot.config, "--port", str(face.robot.port))


def plug(face: HeardFace, _bus: str) -> None:
    """Unplug the port while the face is driven, stopped, frozen and silent.

    What the face and its commands say meanwhile is collected, to be checked afterwards.
    """
    daemon, device = face.begin_face(*_DAEMON), face.robot.device
    face.wait_until_driven()
    device.unplug()
    face.wait(_STAYS_S)
    face.command("status")
    face.command("servo", face.first_servo, "off")
    device.plug_in()
    face.wait(2.0)
    face.command("servo", face.first_servo, "on")
    face.wait_until_driven()
    face.send("freeze")
    device.unplug()
    face.wait(_STAYS_S)
    face.command("stop", "--freeze")
    face.command("status", "--json")
    device.plug_in()
    face.wait(1.5)
    face.send("start")
    face.wait_until_driven()
    device.unplug()
    face.wait(_STAYS_S)
    stopping = face.begin("stop")
    face.wait(2.0)
    face.send("freeze")
    face.command("status")
    device.plug_in()
    face.wait_until_limp()
    face.wait_exit(stopping, "stop")
    device.unplug()
    face.wait(0.5)
    face.command("start")
    face.wait(_STAYS_S)
    device.plug_in()
    face.wait(1.5)
    face.command("start")
    face.wait(1.0)
    device.unplug()
    daemon.send_signal(signal.SIGTERM)
    face.wait(1.0)
    device.plug_in()
    face.wait_exit(daemon, _name(_DAEMON))


def mute(face: HeardFace, bus: str) -> None:
    """Let the controller, or all servos, receive nothing any more; then one servo alone.

    What the face and its commands say meanwhile is collected, to be checked afterwards.
    """
    daemon, truth = face.begin_face(*_DAEMON), face.robot.device.truth
    face.wait_until_driven()
    truth.mute(None, muted=True)
    face.wait(1.5)
    face.command("status")
    face.command("stop", "--freeze")
    face.wait(_STAYS_S)
    face.command("stop", "--limp")
    face.command("status")
    face.wait(1.0)
    face.command("start")
    truth.mute(None, muted=False)
    face.wait_until_limp()
    face.wait_for_state("stopped")
    face.wait(_STAYS_S)
    face.command("start")
    face.wait_until_driven()
    if bus in SERIAL:
        truth.mute(1, muted=True)
        face.wait(1.5)
        face.command("status")
        face.command("stop")
        face.wait(_STAYS_S)
        face.command("stop", "--freeze")
        face.command("start")
        face.wait(2.0)
        truth.mute(1, muted=False)
        face.wait_until_driven(20.0)
        face.wait(1.0)
        face.send("freeze")
        truth.mute(1, muted=True)
        face.wait(1.5)
        face.command("stop", "--json")
        truth.mute(1, muted=False)
        face.wait_until_limp()
        face.wait(1.0)
    daemon.send_signal(signal.SIGTERM)
    face.wait_exit(daemon, _name(_DAEMON))


def processes(face: HeardFace, _bus: str) -> None:
    """Kill or hang the face's processes while it is driven, frozen, stopped and started.

    What the face and its commands say meanwhile is collected, to be checked afterwards.
    """
    daemon = face.begin_face(*_DAEMON)
    face.wait_until_driven()
    os.kill(face.child(daemon, "bridge"), signal.SIGKILL)
    face.wait(0.1)
    face.command("status")
    face.wait_until_driven()
    os.kill(face.child(daemon, "bridge"), signal.SIGSTOP)
    face.wait(2.5)
    face.wait_until_driven()
    os.kill(face.child(daemon, "bridge"), signal.SIGKILL)
    face.wait(0.05)
    face.send("freeze")
    face.command("status")
    face.wait(1.0)
    face.wait_for_state("frozen", "stopped", timeout_s=15.0)
    face.send("start")
    face.wait_until_driven()
    face.send("freeze")
    face.wait(0.5)
    os.kill(face.child(daemon, "bridge"), signal.SIGKILL)
    face.wait(_STAYS_S)
    face.command("stop", "--freeze")
    face.wait_for_state("frozen", timeout_s=15.0)
    face.command("start")
    face.wait_until_driven()
    os.kill(face.child(daemon, "bridge"), signal.SIGKILL)
    face.command("stop")
    face.wait_for_state("stopped", timeout_s=15.0)
    face.command("servo", face.first_servo, "off")
    face.command("status")
    face.send("start")
    face.wait(0.2)
    face.send("freeze")
    face.wait(1.0)
    face.command("servo", face.first_servo, "on", face_state="of a stopped face")
    face.command("start")
    os.kill(face.child(daemon, "speech"), signal.SIGSTOP)
    face.wait_for_state("silent", timeout_s=8.0)
    face.wait(_STAYS_S)
    face.command("status")
    face.command("stop", "--freeze")
    face.command("start")
    face.command("stop", "--end")
    face.wait_exit(daemon, _name(_DAEMON))


def faults(face: HeardFace, bus: str) -> None:
    """Let servos jam, fail and lose power, and a controller lose its power.

    What the face and its commands say meanwhile is collected, to be checked afterwards.
    """
    daemon = face.begin_face(*_DAEMON)
    face.wait_until_driven()
    chain, names = face.robot.chain, list(face.robot.settings.servos)
    if bus in SERIAL:
        chain.motors.jammed[0] = True
        face.wait(4.0)
        face.command("status")
        face.wait_until(lambda: face.last_status.get("servos", {}).get(names[0]) == "failed", 25.0)
        face.command("status")
        face.command("stop", "--freeze")
        face.command("stop")
        face.command("start")
        chain.motors.jammed[0] = False
        face.command("servo", names[0], "on")
        face.wait_until_driven(15.0)
    if bus == "dynamixel":
        chain.servos[1].latch(_OVERLOAD)
        face.wait(1.0)
        face.command("status")
        face.wait_until_driven(15.0)
        chain.servos[2].lose_torque()
        face.wait(1.0)
        face.wait_until_driven(15.0)
    elif bus == "feetech":
        chain.servos[2].power_up()
        face.wait(1.0)
        face.wait_until_driven(15.0)
    else:
        brown_out = chain.brown_out if bus == "maestro" else chain.chip.brown_out
        brown_out()
        face.wait(0.5)
        face.command("status")
        face.wait_until_driven(20.0)
        brown_out()
        face.wait(0.3)
        face.command("stop", "--freeze")
        face.wait(1.5)
        face.command("start")
        face.wait(1.0)
    face.command("stop", "--limp")
    daemon.send_signal(signal.SIGTERM)
    face.wait_exit(daemon, _name(_DAEMON))


def commands(face: HeardFace, _bus: str) -> None:
    """Run commands of one process: `run`, `calibrate neutral`, `limp --port`, `doctor`.

    What the face and its commands say meanwhile is collected, to be checked afterwards.
    """
    where = ("--config", face.robot.config, "--port", str(face.robot.port))
    face.command("calibrate", "neutral", *where)
    face.command("calibrate", "neutral", "--yes", *where)
    for freeze_s in (0.0, 0.3):
        running = face.begin_face("run", "--wav", str(CLIP))
        face.wait_until(lambda: bool(face.robot.controls) or bool(face.robot.torque.any()))
        face.wait_until(lambda: bool(face.robot.torque.any()), 20.0)
        face.wait(freeze_s)
        face.send("freeze")
        face.wait(1.0)
        face.command("status")
        face.command("stop", "--freeze")
        face.command("stop")
        face.wait_exit(running, "run --wav SOUND")
    running = face.begin_face("run", "--wav", str(CLIP))
    face.wait_until_driven()
    running.send_signal(signal.SIGINT)
    face.wait_exit(running, "run --wav SOUND")
    running = face.begin_face("run", "--wav", str(CLIP))
    face.wait_until(lambda: bool(face.robot.torque.all()))
    face.command("limp", "--port", str(face.robot.port))
    face.wait_exit(running, "run --wav SOUND")
    face.command("limp", "--port", str(face.robot.port))
    face.command("limp", *where)
    face.command("doctor", *where)
    face.command("doctor", "--json", *where)


def everybody(face: HeardFace, _bus: str) -> None:
    """Kill all processes at once; then request status, a release and a start from outside.

    What the face and its commands say meanwhile is collected, to be checked afterwards.
    """
    daemon = face.begin_face(*_DAEMON)
    face.wait_until_driven()
    kill_all(daemon)
    face.wait(0.2)
    face.command("status")
    face.wait(3.0)
    face.command("stop")
    face.command("limp", "--port", str(face.robot.port))
    daemon = face.begin_face(*_DAEMON)
    face.wait_until_driven()
    face.command("stop", "--freeze")
    kill_all(daemon)
    face.wait(0.5)
    daemon = face.begin_face(*_DAEMON)
    face.wait_for_state("frozen", "stopped", "driven", timeout_s=30.0)
    face.wait(_STAYS_S)
    face.command("status")
    face.command("stop", "--limp")
    kill_all(daemon)
    daemon = face.begin_face(*_DAEMON)
    face.wait_for_state("stopped", timeout_s=30.0)
    face.wait(_STAYS_S)
    face.command("start")
    daemon.send_signal(signal.SIGTERM)
    daemon.send_signal(signal.SIGTERM)
    face.wait_exit(daemon, _name(_DAEMON))


def starting(face: HeardFace, bus: str) -> None:
    """Start a face with a critical servo: stopped meanwhile, refused, and failed.

    What the face and its commands say meanwhile is collected, to be checked afterwards.
    """
    device, truth = face.robot.device, face.robot.device.truth
    truth.mute(None, muted=True)
    daemon = face.begin_face(*_DAEMON)
    with contextlib.suppress(subprocess.TimeoutExpired):
        daemon.wait(12.0)
    truth.mute(None, muted=False)
    if daemon.poll() is None:
        daemon.send_signal(signal.SIGTERM)
    face.wait_exit(daemon, _name(_DAEMON))
    device.unplug()
    face.wait_exit(face.begin_face(*_DAEMON), _name(_DAEMON))
    device.plug_in()
    face.wait(0.3)
    daemon = face.begin_face(*_DAEMON)
    face.wait_until(lambda: bool(face.robot.torque.any()))
    face.command("stop", "--freeze")
    face.wait(_STAYS_S)
    face.command("status")
    face.command("stop")
    for word in ("freeze", "soft"):
        face.send("start")
        face.wait_until(lambda: bool(face.robot.torque.any()), 20.0)
        face.send(word)
        face.wait(1.0)
    face.send("limp", until_end=True)
    face.command("start")
    face.wait_exit(face.begin_face(*_DAEMON), "daemon at a port in use")
    if bus in SERIAL:
        truth.mute(0, muted=True)
        face.wait(1.5)
        truth.mute(0, muted=False)
        face.wait(2.0)
        face.robot.chain.motors.jammed[0] = True
        with contextlib.suppress(subprocess.TimeoutExpired):
            daemon.wait(25.0)
        face.command("status")
        face.robot.chain.motors.jammed[0] = False
    if daemon.poll() is None:
        daemon.send_signal(signal.SIGTERM)
    face.wait_exit(daemon, _name(_DAEMON))


def _name(arguments: tuple[str, ...]) -> str:
    return arguments[0]


Scene = Callable[[HeardFace, str], None]
#: Played with a critical servo.
CRITICAL: Final = ("starting",)
#: By name.
SCENES: Final[dict[str, Scene]] = {
    each.__name__: each
    for each in (orders, plug, mute, processes, faults, commands, everybody, starting)
}
