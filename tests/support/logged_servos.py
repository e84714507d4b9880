"""Servos as a health log keeps them."""

from datetime import UTC, datetime

from firmware_bridge.bus import ServoHealth

NOON = datetime(2026, 11, 22, 12, tzinfo=UTC)


def servo(name="jaw", **said):
    usual = {
        "servo_id": 11, "state": "driven", "temperature_degc": 40.0, "load": 0.12,
        "voltage_v": 5.0, "current_ma": 180.0, "hardware_errors": 0, "n_reboots": 0,
        "n_unanswered": 0, "torque_on": True,
    }  # fmt: skip
    return ServoHealth(name, **{**usual, **said})
