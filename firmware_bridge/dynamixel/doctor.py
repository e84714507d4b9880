"""Checks of everything that can be wrong between a computer and its Dynamixels; only reads."""

import statistics
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Final

from firmware_bridge.bus_kinds import Finding, Severity
from firmware_bridge.dynamixel.bus import budget, slow_adapter
from firmware_bridge.dynamixel.mounting import MountedServo
from firmware_bridge.dynamixel.provisioning import (
    locate,
    read_settings,
    shares_id,
    wanted_settings,
)
from firmware_bridge.dynamixel.wire import codec
from firmware_bridge.dynamixel.wire.codec import SpanRead
from firmware_bridge.dynamixel.wire.line import Line
from firmware_bridge.serial_servos.doctor import (
    ServoCondition,
    servo_findings,
    shared_id,
    strangers,
)
from firmware_bridge.serial_servos.mounting import SETUP
from firmware_bridge.serial_servos.provisioning import differences

_PINGS: Final = 7
_TRIES: Final = 3


def measured_latency_s(line: Line, servo_id: int) -> float | None:
    """Return the median time by which a servo's ping answers exceed their time on the wire, in s.

    Includes the servo's return delay and the computer's own time. None when it does not answer.
    """
    clock = line.transport.clock
    # The request, and an answer with three bytes of data.
    wire_s = (len(codec.ping(servo_id)) + codec.EMPTY_STATUS_SIZE + 3) * line.byte_s
    elapsed_s = []
    for _ in range(_PINGS):
        start_s = clock.now()
        if line.ping(servo_id) is not None:
            elapsed_s.append(clock.now() - start_s - wire_s)
    return max(0.0, statistics.median(elapsed_s)) if elapsed_s else None


_UDEV: Final = "install the udev rule (docs/hardware.md), or `echo 1` into its latency_timer"
#: Of the stall torque: proposed where nothing bounds a servo; the shipped faces' jaws have it.
_GENTLE_SHARE: Final = 0.3
#: Later than this, answers are held back by something: a USB frame is 1 ms, a busy computer less.
_SLOW_S: Final = 0.004
_STATE: Final = (
    "firmware_version",
    "torque_enable",
    "hardware_error_status",
    "present_input_voltage",
    "present_temperature",
    "min_voltage_limit",
    "max_voltage_limit",
    "temperature_limit",
    "return_delay_time",
)


def examine(
    line: Line, servos: Sequence[MountedServo], rate_hz: float, latency_timer_ms: int | None
) -> Iterator[Finding]:
    """Yield findings about adapter, bus and servos in the order of the checks; write to no servo.

    line: open at the YAML's baud rate, and with longer waits than a control loop allows. rate_hz:
    ticks a second that the bus should manage. latency_timer_ms: what the adapter's driver declares;
    None: it declares nothing, so the latency is measured.
    """
    wanted_rate = line.baud_rate
    ids = [servo.joint.servo_id for servo in servos]
    at_rate, no_answer = locate(line, ids)
    if no_answer is not None:
        yield no_answer
        yield from _adapter(line, None, latency_timer_ms)
        return
    there = [each for each in ids if at_rate.get(each, (0,))[0] == wanted_rate]
    yield from _adapter(line, there[0] if there else None, latency_timer_ms)
    # Those that answer at another rate only need not be asked.
    unclear = [each for each in ids if each in there or each not in at_rate]
    doubled = [each for each in unclear if shares_id(line, each)]
    yield from (shared_id(f"id {each}") for each in doubled)
    yield from _fast_read(line, [each for each in there if each not in doubled])
    for servo in servos:
        servo_id = servo.joint.servo_id
        if servo_id not in doubled:
            seen, condition = at_rate.get(servo_id), partial(_condition, line, servo)
            yield from servo_findings(servo.joint, servo.model.name, seen, wanted_rate, condition)
    yield from strangers(at_rate, ids)
    yield from _strength(servos)
    slow = budget(len(servos), wanted_rate, rate_hz)
    held_back = slow_adapter(len(servos), wanted_rate, rate_hz, latency_timer_ms)
    if slow is not None:
        yield Finding(Severity.BAD, slow, f"then {SETUP}")
    elif held_back is not None:
        yield Finding(Severity.BAD, held_back, _UDEV)
    else:
        yield Finding(
            Severity.GOOD,
            f"{len(servos)} servos at {wanted_rate:,} baud can do {rate_hz:g} Hz with feedback",
        )


def _strength(servos: Sequence[MountedServo]) -> Iterator[Finding]:
    """Yield a warning naming the servos without `max_current_ma` whose current could be limited."""
    unbounded = [s for s in servos if s.model.measures_current and s.max_current_ma is None]
    if not unbounded:
        return
    names = ", ".join(servo.joint.name for servo in unbounded)
    model = unbounded[0].model
    gentle_ma = round(_GENTLE_SHARE * model.stall_a * 1e3, -1)
    yield Finding(
        Severity.WARNING,
        f"without max_current_ma these pull as hard as they can: {names}",
        f"write `max_current_ma: {gentle_ma:.0f}`, three tenths of what an {model.name} takes, "
        f"then {SETUP}",
    )


def _adapter(line: Line, servo_id: int | None, latency_timer_ms: int | None) -> Iterator[Finding]:
    """Yield findings about the adapter: whether it delays answers, or echoes what was sent.

    latency_timer_ms: the delay that the adapter's driver declares; None: it declares none, and the
    answers of servo `servo_id` are timed instead. servo_id: None: no servo answers.
    """
    if latency_timer_ms is None:
        latency_s = measured_latency_s(line, servo_id) if servo_id is not None else None
        if latency_s is not None and latency_s > _SLOW_S:
            yield Finding(
                Severity.WARNING,
                f"answers come {latency_s * 1e3:.0f} ms later than on the wire",
                "give the adapter a USB port of its own; see its driver for a latency setting",
            )
        else:
            yield Finding(Severity.GOOD, "the adapter has no latency timer to set")
    elif latency_timer_ms <= 1:
        yield Finding(Severity.GOOD, "the adapter's latency timer is 1 ms")
    else:
        what = f"the adapter holds bytes back for {latency_timer_ms} ms"
        yield Finding(Severity.WARNING, what, _UDEV)
    if line.echoes:
        what = "the adapter gives back what is sent (echo); that is swallowed"
        yield Finding(Severity.WARNING, what, "nothing to do; switch echo off if the adapter can")


def _fast_read(line: Line, ids: Sequence[int]) -> Iterator[Finding]:
    """Yield a warning that names those of `ids` that do not answer Fast Sync Read, if any.

    All of them answer a ping.
    """
    spans = [SpanRead((each,), 0, 2, fast=True) for each in ids]
    deaf = [span.ids[0] for span in spans if not any(line.sync_read(span) for _ in range(_TRIES))]
    if deaf:
        named = "all servos" if len(deaf) == len(ids) else f"ids {', '.join(map(str, deaf))}"
        yield Finding(
            Severity.WARNING,
            f"{named} do not answer Fast Sync Read; plain sync read is used, which takes longer",
            "nothing to do, unless there is newer firmware (Dynamixel Wizard)",
        )


def _condition(line: Line, servo: MountedServo) -> ServoCondition:
    """Read and return a servo's condition. Raises ServoError if the servo stops answering."""
    servo_id, model = servo.joint.servo_id, servo.model
    state = read_settings(line, servo_id, model, _STATE)
    wanted = wanted_settings(servo, line.baud_rate)
    return ServoCondition(
        firmware=str(state["firmware_version"]),
        volts=state["present_input_voltage"] / 10.0,
        least_v=state["min_voltage_limit"] / 10.0,
        most_v=state["max_voltage_limit"] / 10.0,
        warmth_degc=state["present_temperature"],
        hottest_degc=state["temperature_limit"],
        errors=state["hardware_error_status"],
        torque_on=bool(state["torque_enable"]),
        differences=differences(read_settings(line, servo_id, model, wanted), wanted),
    )
