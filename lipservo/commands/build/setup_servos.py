"""`setup-servos`: writes the settings of the face's YAML into each servo's own memory."""

import contextlib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from firmware_bridge.errors import BusError, ServoError
from lipservo.commands.options import DEFAULT_FACE, Bus, Config, Json, Port, port_of
from lipservo.terminal.output import RESULTS, complain, print_json
from lipsync.errors import UserError

if TYPE_CHECKING:
    from firmware_bridge.stop_signals import DeferredSignals

_INPUT_ENDED: Final = (
    "not every servo answered at its own id, and the input ended before each was connected alone; "
    "check power and cable"
)


@dataclass(slots=True)
class _Work:
    """The set-up of some servos: the planned changes of their registers, and those done.

    tools: functions that set up servos on this kind of bus (`BusKind.workshop`). servos: to be set
    up, each with its joint. plans: of one servo each, for the first of `servos`. done: (joint,
    register) of each change that was written.
    """

    tools: Any
    servos: list[Any]
    port: str
    baud_rate: int
    dry_run: bool
    as_json: bool
    plans: list[Any] = field(default_factory=list)
    done: set[tuple[str, str]] = field(default_factory=set)

    def rows(self, *, done: bool) -> list[str]:
        """Return a line for each register change: the written ones if `done`, else the others.

        The others end with each servo that was not reached, so that its changes are not known.
        """
        changes = [
            f"{plan.servo.joint.name}: {each.name} {each.found} -> {each.wanted}"
            for plan in self.plans
            for each in plan.changes
            if ((plan.servo.joint.name, each.name) in self.done) == done
        ]
        unreached = [] if done else self.servos[len(self.plans) :]
        return changes + [f"{servo.joint.name}: not reached" for servo in unreached]

    def say(self, line: str) -> None:
        """Print a result line, unless the result is printed as JSON."""
        if not self.as_json:
            RESULTS.print(line)


def setup_servos(
    joints: Annotated[
        list[str] | None, typer.Argument(help="Joints whose servos are set up; default: all.")
    ] = None,
    port: Port = None,
    config: Config = DEFAULT_FACE,
    bus: Bus = None,
    dry_run: Annotated[bool, typer.Option(help="Only list what would be written.")] = False,
    as_json: Json = False,
) -> None:
    """Write id, baud rate and limits into each servo; only differences are written, torque is off.

    If all servos answer at their own ids, leave them connected. Otherwise connect one at a time:
    without JOINTS the command asks for one after the other; with one joint it asks nothing.
    """
    from firmware_bridge.stop_signals import DeferredSignals, StopRequested
    from lipservo.runtime.servos.assembly import load_settings

    settings, _ = load_settings(config)
    if bus is not None:
        settings = settings.of_bus(bus)
    if port is not None and not settings.buses:
        settings = settings.at_port(port)
    keeps_settings = settings.capabilities.set_up or settings.bus_kind.at_port
    tools = settings.bus_kind.workshop() if keeps_settings else None
    servos = settings.servos if tools is None else tools.servos_by_joint(settings.wiring)
    unknown = [name for name in joints or () if name not in servos]
    if unknown:
        raise UserError(f"this face has no joint {unknown[0]!r}; it has {', '.join(servos)}")
    if tools is None:
        if as_json:
            print_json({"dry_run": dry_run, "complete": True, "error": "", "servos": []})
            return
        RESULTS.print(
            f"nothing to set up: servos on a {settings.bus.kind} bus keep no settings; find their "
            "limits with `lipservo jog JOINT`, or on the page Servos of `lipservo jog --dashboard`"
        )
        return
    chosen = [servos[name] for name in dict.fromkeys(joints or servos)]
    servo_port, rate = port_of(port, settings.bus.port), getattr(settings.bus, "baud_rate", 0)
    work = _Work(tools, chosen, servo_port, rate, dry_run, as_json)
    status, error = 0, ""
    with DeferredSignals() as signals:
        try:
            _set_up_servos(work, signals, ask=joints is None or len(chosen) > 1)
        except StopRequested as stop:
            status, error = 128 + stop.number, f"stopped by {stop}"
        except (UserError, BusError) as failure:
            status, error = 1, str(failure)
        except typer.Abort:
            status, error = 1, _INPUT_ENDED
        with contextlib.suppress(StopRequested), signals.finish_first():
            _print_result(work, error)
    raise typer.Exit(status)


def _set_up_servos(work: _Work, signals: "DeferredSignals", *, ask: bool) -> None:
    """Write settings into servos, all connected together or one at a time; add plans to `work`.

    ask: if the chain is not complete, prompt for each servo to be connected alone; False: take the
    one connected servo for the first that is missing. Raises ServoError if several servos answer
    then.
    """
    tools, servos = work.tools, work.servos
    with tools.unhurried_line(work.port, work.baud_rate) as line:
        found = tools.find_servos(line, [servo.joint.servo_id for servo in servos], work.baud_rate)
        # All at once if each answers at its own id; else one that may not be asked for, alone.
        if tools.chain_is_complete(servos, found):
            work.plans = tools.plan_chain(line, servos, found, work.baud_rate)
        elif not ask or sum(map(len, found.values())) > 1:
            missing = [each for each in servos if each.joint.servo_id not in found]
            work.plans = [tools.plan_alone(line, missing[0], found, work.baud_rate)]
        for plan in work.plans:
            _write_changes(work, line, plan, signals)
    while len(work.plans) < len(servos):
        servo = servos[len(work.plans)]
        question = f"Connect the servo of {servo.joint.name!r} alone, then press Enter"
        typer.prompt(question, "", show_default=False, err=True)
        with tools.unhurried_line(work.port, work.baud_rate) as line:
            found = tools.find_servos(line, [servo.joint.servo_id], work.baud_rate)
            if name := _still_connected(work, line, found):
                typer.echo(f"this is the servo of {name!r}, set up just now", err=True)
                continue
            work.plans.append(tools.plan_alone(line, servo, found, work.baud_rate))
            _write_changes(work, line, work.plans[-1], signals)


def _still_connected(work: _Work, line: Any, found: Any) -> str:
    """Return the joint whose servo, set up just now, is the one connected; "": another one is.

    found: all servos that answer. Registers are compared: a new servo may have the id of a joint.
    """
    for servo in (plan.servo for plan in work.plans if plan.servo.joint.servo_id in found):
        with contextlib.suppress(ServoError):  # several answer, or of another model
            if not work.tools.plan_alone(line, servo, found, work.baud_rate).changes:
                return str(servo.joint.name)
    return ""


def _write_changes(work: _Work, line: Any, plan: Any, signals: "DeferredSignals") -> None:
    """Write one servo's register changes; in a dry run only print them.

    line: the open serial bus. plan: the servo's changes. signals: a signal is handled between two
    changes, never within one.
    """
    name = plan.servo.joint.name
    if work.dry_run:
        for each in plan.changes:
            work.say(f"{name}: {each.name} {each.found} -> {each.wanted} (not written)")
        if not plan.changes:
            work.say(f"{name}: nothing to change")
        return
    line.baud_rate = plan.baud_rate
    steps = work.tools.set_up(line, plan.servo_id, plan.servo.model, plan.changes)
    while True:
        with signals.finish_first():
            change = next(steps, None)
            if change is None:
                break
            work.done.add((name, change.name))
            work.say(f"{name}: {change.name} {change.found} -> {change.wanted}")
    work.say(f"{name}: set up as id {plan.servo.joint.servo_id}")


def _print_result(work: _Work, error: str) -> None:
    """Print the result as JSON if wanted, and any error with the changes written and unwritten."""
    if work.as_json:
        servos = [
            {
                "joint": plan.servo.joint.name,
                "id": plan.servo.joint.servo_id,
                "found_id": plan.servo_id,
                "found_baud_rate": plan.baud_rate,
                "changes": [
                    {
                        "register": each.name,
                        "found": each.found,
                        "wanted": each.wanted,
                        "set": (plan.servo.joint.name, each.name) in work.done,
                    }
                    for each in plan.changes
                ],
            }
            for plan in work.plans
        ]
        complete = not error and not work.rows(done=False)
        print_json(
            {"dry_run": work.dry_run, "complete": complete, "error": error, "servos": servos}
        )
    if error and work.plans and not work.dry_run:
        done, left = work.rows(done=True), work.rows(done=False)
        error += f"; set: {', '.join(done) or 'nothing'}; not set: {', '.join(left) or 'nothing'}"
        error += "; torque is off where anything was set"
    if error:
        complain(error)
