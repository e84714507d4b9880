"""Simulated servos in a process of their own, for as long as a caller needs them."""

import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass

from firmware_bridge.port_names import ports_text
from lipservo.runtime.servos.assembly import load_settings
from lipsync.errors import UserError

_END_S = 5.0


@dataclass(frozen=True, slots=True)
class SimulatedServos:
    """A running process of simulated servos, and the serial port at which they answer."""

    port: str
    process: "subprocess.Popen[str]"

    def turn(self, index: int, by_deg: float) -> None:
        """Turn a servo by degrees, as fingers would; with torque on it resists. index: from 0."""
        assert self.process.stdin is not None
        with suppress(OSError):  # it has ended, and its port with it
            self.process.stdin.write(f"{index} {by_deg:.1f}\n")
            self.process.stdin.flush()


@contextmanager
def simulated_port(arguments: Sequence[str]) -> Iterator[str]:
    """Run `lipservo sim-bus` with `arguments` until the block ends; yield the servos' port."""
    with simulated_servos(arguments) as servos:
        yield servos.port


@contextmanager
def simulated_servos(arguments: Sequence[str]) -> Iterator[SimulatedServos]:
    """Run `lipservo sim-bus` with `arguments` until the block ends; yield port and process.

    The simulator also ends when this process dies, since its standard input closes then. A Ctrl-C
    in the terminal does not reach it: servos stay until the process that drives them has released
    them. Raises UserError if it does not start.
    """
    argv = [sys.executable, "-P", "-m", "lipservo", "sim-bus", "--until-stdin-closes", *arguments]
    with subprocess.Popen(
        argv, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, process_group=0
    ) as process:
        try:
            assert process.stdout is not None
            port = process.stdout.readline().strip()
            if not port:
                raise UserError("the simulator did not start; `lipservo sim-bus` says why")
            yield SimulatedServos(port, process)
        finally:
            process.terminate()
            try:
                process.wait(_END_S)
            except subprocess.TimeoutExpired:
                process.kill()


@contextmanager
def servo_port(port: str | None, sim: str | None, config: str) -> Iterator[str | None]:
    """Yield the user's port, or for `--sim pty` the port of servos simulated until the block ends.

    config: the face whose servos are simulated. Yields None if `port` and `sim` are None: the
    YAML's port. Raises UserError for any other `sim`, and for `sim` together with a port.
    """
    if sim is None:
        yield port
        return
    if sim != "pty" or port is not None:
        raise UserError("--sim only accepts `pty`, and not together with --port")
    buses = load_settings(config)[0].buses
    if not buses:
        with simulated_port(["--config", config]) as made:
            yield made
        return
    with ExitStack() as stack:
        ports = {
            name: stack.enter_context(simulated_port(["--config", config, "--bus", name]))
            for name in buses
        }
        yield ports_text(ports)
