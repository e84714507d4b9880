"""`jog` and `neutral`: joints moved by keys, page or command, or turned by hand with torque off."""

from contextlib import ExitStack, suppress
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lipservo.commands.options import DEFAULT_FACE, Config, Dashboard, OpenPage, Port, port_of
from lipservo.runtime.servos.face_stopped import exit_status
from lipservo.terminal.output import MESSAGES, RESULTS, complain, say_simulated
from lipsync.errors import UserError

if TYPE_CHECKING:
    from firmware_bridge.loop.bridge import Bridge
    from firmware_bridge.stop_signals import DeferredSignals
    from lipservo.runtime.servos.hand_driven import KeyedJoint
    from lipservo.runtime.servos.limp_servos import LimpServos, TurnedRange
    from lipservo.settings.settings import FaceSettings
    from lipservo.terminal.keys import PressedKeys

_LIMIT_KEYS = {"1": "min", "2": "neutral", "3": "max"}


def jog(
    joint: Annotated[str | None, typer.Argument(help="Joint to move.")] = None,
    deg: Annotated[
        float | None,
        typer.Argument(help="Angle to move to, joint degrees; default: move by keys."),
    ] = None,
    port: Port = None,
    config: Config = DEFAULT_FACE,
    hold_s: Annotated[float, typer.Option(min=0.0, max=60.0, help="Seconds to stay at DEG.")] = 1.0,
    limp: Annotated[
        bool, typer.Option("--limp", help="Torque off: turn joints by hand, and see how far.")
    ] = False,
    dashboard: Dashboard = False,
    open_page: OpenPage = False,
) -> None:
    """Move one joint within its limits, while the others hold; then switch torque off.

    JOINT without DEG: you move it with keys, a hobby servo also a little beyond its limits, to find
    them. --dashboard: the same on a web page, for all joints. --limp: torque is off, and the
    command shows how far you turn each joint by hand. You can write the limits found into the
    face's YAML. No calibration is needed.
    """
    from lipservo.commands.run.dashboard_beside import check_page_options

    check_page_options(None, is_shown=dashboard, open_page=open_page)
    settings = _settings(port, config)
    if joint is not None and joint not in settings.servos:
        raise UserError(f"this face has no joint {joint!r}; it has {', '.join(settings.servos)}")
    if deg is not None and (limp or dashboard or joint is None):
        raise typer.BadParameter("DEG needs JOINT, and no --limp or --dashboard")
    if limp and dashboard:
        raise typer.BadParameter("give --limp or --dashboard, not both")
    if limp:
        _note_ranges(settings, config, port, [joint] if joint else list(settings.servos))
    elif dashboard:
        _jog_on_page(settings, config, open_page=open_page)
    elif joint is None:
        raise typer.BadParameter("no joint given; name one, or give --dashboard or --limp")
    elif deg is None:
        _jog_with_keys(settings, config, joint)
    else:
        _move_and_report(settings, {joint: deg}, hold_s, may_jump=False)


def neutral(
    port: Port = None,
    config: Config = DEFAULT_FACE,
    yes: Annotated[
        bool, typer.Option("--yes", help="Hobby servos without a pulse so far may jump to neutral.")
    ] = False,
) -> None:
    """Move every joint to its neutral, within limits and speeds; then switch torque off."""
    _move_and_report(_settings(port, config), None, 0.5, may_jump=yes)


def _settings(port: str | None, config: str) -> "FaceSettings":
    from lipservo.runtime.servos.assembly import load_settings

    settings, _ = load_settings(config)
    return settings if port is None else settings.at_port(port)


def _move_and_report(
    settings: "FaceSettings", wanted_deg: dict[str, float] | None, hold_s: float, *, may_jump: bool
) -> None:
    """Move joints as `move_to` does, and print where each ended, of a hobby servo in us as well.

    Raises typer.Exit with 1 if a joint did not hold, or is measured more than `STALL_DEG` from the
    goal sent to it; with 3 if a servo did not confirm torque off; else with 0.
    """
    from calibration.mouth_servos import STALL_DEG
    from lipservo.runtime.servos.moving import move_to

    _say_if_simulated(settings)
    moved, status = move_to(settings, wanted_deg, hold_s, may_jump=may_jump), 0
    for joint in wanted_deg or settings.servos:
        deg, sent_deg = moved.reached_deg[joint], moved.sent_deg[joint]
        if not moved.is_held[joint]:
            status = 1
            complain(f"{joint}: its servo did not confirm that it held, so its angle is unknown")
        elif moved.is_measured[joint]:
            RESULTS.print(f"{joint} stands at {deg:.1f} deg, sent to {sent_deg:.1f} deg")
            if (off_deg := abs(deg - sent_deg)) > STALL_DEG:
                status = 1
                complain(f"{joint} is {off_deg:.1f} deg off its goal: is it blocked, or too weak?")
        else:
            as_pulse = f" ({p.us(deg):.0f} us)" if (p := settings.servos[joint].pulse) else ""
            RESULTS.print(f"{joint} was sent to {deg:.1f} deg{as_pulse}")
    raise typer.Exit(exit_status(moved.report, None) or status)


def _say_if_simulated(settings: "FaceSettings") -> None:
    if settings.capabilities.in_memory:
        say_simulated()


def _jog_on_page(settings: "FaceSettings", config: str, *, open_page: bool) -> None:
    """Serve the page Servos, whose sliders move the joints, until Ctrl-C; then torque goes off."""
    from firmware_bridge.clock import MonotonicClock
    from lipservo.commands.run.dashboard_beside import dashboard_beside
    from lipservo.commands.run.voice_choice import access_file
    from lipservo.runtime.motion_options import MotionOptions
    from lipservo.runtime.run_request import SILENCE, RunRequest
    from lipservo.runtime.servos.hand_driven import drive_by_hand

    request = RunRequest(config, SILENCE, MotionOptions())
    token_file = access_file(None, open_to_this_computer=False)
    _say_if_simulated(settings)
    with dashboard_beside(request, None, token_file, open_page=open_page):
        MESSAGES.print("the page Servos moves the joints; Ctrl-C lets them go")
        report, signal_number = drive_by_hand(settings, config, MonotonicClock())
    raise typer.Exit(exit_status(report, signal_number))


def _jog_with_keys(settings: "FaceSettings", config: str, name: str) -> None:
    """Move the joint `name` by keys of the terminal until `q` or a stop; then switch torque off.

    The keys 1, 2 and 3 write a hobby servo's limits into the face's YAML, `config`.
    """
    from firmware_bridge.clock import MonotonicClock
    from lipservo.runtime.servos.hand_driven import KeyedJoint, drive_by_hand
    from lipservo.settings.found_limits import WARNING
    from lipservo.terminal.keys import PressedKeys

    hand = KeyedJoint(settings, name)
    _say_if_simulated(settings)
    if hand.pulse is None:
        MESSAGES.print("- +: a degree; , .: a tenth; 0: neutral; q: end")
    else:
        MESSAGES.print("- +: 10 us; , .: 2 us; 0: neutral; 1 2 3: set as min, neutral, max; q: end")
        MESSAGES.print(WARNING)
    with PressedKeys() as keys:

        def act(bridge: "Bridge", time_s: float) -> bool:
            """Carry out the next pressed key, if any; return False for `q`, the end.

            Called in each tick, at monotonic `time_s`.
            """
            if not hand.renew(bridge, time_s):
                RESULTS.print(f"{hand.shown}: back within its limits")
            key = keys.next_key(0.0)
            if key is None:
                return True
            if limit := _LIMIT_KEYS.get(key):
                RESULTS.print(_write_limit(hand, config, limit))
                return True
            why_not = hand.press(key, bridge, time_s)
            if why_not is not None:
                RESULTS.print(why_not or hand.shown)
            return key != "q"

        report, signal_number = drive_by_hand(settings, config, MonotonicClock(), act)
    raise typer.Exit(exit_status(report, signal_number))


def _write_limit(hand: "KeyedJoint", config: str, limit: Any) -> str:
    """Write the joint's present pulse as `limit` into the face's YAML; return a result line.

    hand: the joint. limit: `min`, `neutral` or `max`. The line reports what was written, or why
    nothing was.
    """
    from lipservo.settings.found_limits import forget_poses, own_yaml, what_next, with_pulse_limit

    if hand.pulse is None:
        return "limits in degrees are found with torque off: `lipservo jog --limp`"
    try:
        edit = with_pulse_limit(own_yaml(config), hand.name, limit, hand.place)
        edit.write()
        if limit == "neutral" and edit.text != edit.before:
            forget_poses(edit.path)
    except UserError as error:
        return str(error)
    return f"{hand.name}: {limit} is {hand.place:.0f} us in {edit.path.name}; it {what_next(edit)}"


def _note_ranges(settings: "FaceSettings", config: str, port: str | None, names: list[str]) -> None:
    """Switch torque off, and record how far joints are turned by hand; w writes it to the YAML.

    names: of the joints. port: None: the YAML's. config: the face's name or YAML path.
    """
    from firmware_bridge.clock import MonotonicClock
    from firmware_bridge.stop_signals import DeferredSignals, StopRequested
    from firmware_bridge.stopping import named_by_reason
    from lipservo.runtime.servos.assembly import bus_for
    from lipservo.runtime.servos.limp_servos import LimpServos, TurnedRange
    from lipservo.terminal.keys import PressedKeys

    known = list(settings.servos)
    silent = [n for n in names if not settings.capabilities.of(known.index(n)).place]
    if silent:
        raise UserError(
            f"{', '.join(silent)}: these servos cannot say where they stand: find their limits "
            "with `lipservo jog JOINT`, or on the page Servos of `lipservo jog --dashboard`"
        )
    settings = settings.at_port(port_of(port, settings.servo_port))
    status, clock = 0, MonotonicClock()
    with ExitStack() as stack, DeferredSignals() as signals:
        try:
            bus = bus_for(settings, clock)
            with signals.finish_first():
                stack.enter_context(bus)
            servos = LimpServos(settings, bus, clock, names)
            keys = stack.enter_context(PressedKeys())
            MESSAGES.print(
                f"{', '.join(names)}: let go now, and what they hold falls. "
                "Space or Enter: let go. Any other key: leave all as it is."
            )
            while (key := keys.next_key(1.0)) is None:
                pass
            if key not in (" ", "\n", "\r"):
                raise UserError("nothing was let go")
            with signals.finish_first():
                report = servos.let_go()
            if not report.complete:
                raise UserError(
                    f"torque off is NOT confirmed by {named_by_reason(report.unconfirmed)}; "
                    "keep your hands away"
                )
            MESSAGES.print(
                "Turn each joint to both of its ends. w: write the limits; r: begin anew; q: end"
            )
            _show_positions(servos, TurnedRange(servos.names), keys, signals, config)
        except StopRequested as stop:
            status = 128 + stop.number
            complain(f"stopped by {stop}; torque stays off")
    raise typer.Exit(status)


def _show_positions(
    servos: "LimpServos",
    turned: "TurnedRange",
    keys: "PressedKeys",
    signals: "DeferredSignals",
    config: str,
) -> None:
    """Show the limp joints' positions and ranges until q or w is pressed; r begins them anew.

    w writes the ranges into the YAML of the face, `config`.
    """
    from rich.live import Live

    from lipservo.runtime.servos.limp_servos import READ_EVERY_S

    with Live(console=MESSAGES, transient=True, auto_refresh=False) as view:
        key: str | None = None
        while key not in ("q", "w"):
            turned.note(servos.read_pose())
            if MESSAGES.is_terminal:
                view.update(turned.table(), refresh=True)
            key = keys.next_key(READ_EVERY_S)
            if key == "r":
                turned.begin()
    for line in turned.lines():
        RESULTS.print(line)
    if key == "w":
        with suppress(KeyboardInterrupt), signals.finish_first():
            _write_ranges(turned, config)


def _write_ranges(turned: "TurnedRange", config: str) -> None:
    """Write the ranges through which a person turned limp joints into the face's YAML.

    A joint whose range is refused stays as it is, and is printed. Raises UserError if no joint is
    left.
    """
    from lipservo.settings.found_limits import own_yaml, range_values, what_next, with_ranges

    found = {}
    for name, (least_deg, most_deg) in turned.ends().items():
        try:
            found[name] = range_values(least_deg, most_deg)
        except UserError as error:
            RESULTS.print(f"{name}: stays as it is: {error}")
    if not found:
        raise UserError("nothing was written: no joint was turned")
    edit = with_ranges(own_yaml(config), found)
    edit.write()
    for name, values in found.items():
        RESULTS.print(f"{name}: {values['min_deg']:g} to {values['max_deg']:g} deg")
    RESULTS.print(
        f"written into {edit.path.name}; it {what_next(edit)}. Then `lipservo setup-servos`: "
        "servos keep limits of their own"
    )
