"""What the pages are told once, as JSON: limits, models, the rig, words and colours."""

from typing import Final

from firmware_bridge.dynamixel.control_table import servo_models
from lipservo.dashboard.pages.robot_rig import robot_rig
from lipservo.face.assembly import load_settings
from lipservo.settings.settings import FaceSettings, ServoSettings
from lipsync.phonemes import PHONEMES, SILENCE, VISEME_OF

#: What is seen on the lips: a word for a legend, colours of the block and of its letters
#: (contrast of at least 4.5 to 1), and the viseme classes by their first phoneme.
GROUPS: Final = {
    "closed": ("lips shut", "#9b2c3d", "#ffffff", ("P",)),
    "bitten": ("lip to teeth", "#b0561a", "#ffffff", ("F",)),
    "round": ("rounded", "#6b4fa0", "#ffffff", ("W", "AO", "UW", "SH", "ER", "R")),
    "open": ("open", "#12655c", "#ffffff", ("AA", "EH", "HH")),
    "spread": ("spread", "#1f5f99", "#ffffff", ("IY",)),
    "inside": ("made inside", "#dbe2e8", "#24313d", ("TH", "T", "K")),
}
_VOLT_UNIT: Final = 0.1


def settings_of(config: str | None) -> FaceSettings | None:
    """Of the face that a status names; None where it names none that can be read."""
    if config is None:
        return None
    try:
        return load_settings(config)[0]
    except (ValueError, OSError):
        return None


def page_facts(config: str | None) -> dict[str, object]:
    """For the face of this config, by name or path; without one the servos are dials."""
    settings = settings_of(config)
    servos = {} if settings is None else settings.servos
    return {
        "config": config,
        "rateHz": None if settings is None else settings.rate_hz,
        "servos": {name: servo_facts(servo) for name, servo in servos.items()},
        "rig": {
            name: {"channel": found.channel, "side": found.side, "sign": found.sign}
            for name, found in robot_rig(servos).items()
        },
        "phonemeGroups": {name: group_of(name) for name in PHONEMES if name != SILENCE},
        "groupColours": {name: (fill, ink) for name, (_, fill, ink, _) in GROUPS.items()},
    }


def servo_facts(servo: ServoSettings) -> dict[str, object]:
    """Limits in joint degrees, and what its model bears: its factory limits."""
    model = servo_models()[servo.model]
    return {
        "id": servo.id,
        "model": servo.model,
        "part": servo.part,
        "positive": servo.positive,
        "least_deg": servo.min_deg,
        "most_deg": servo.max_deg,
        "hottest_degc": model.defaults["temperature_limit"],
        "least_v": model.defaults["min_voltage_limit"] * _VOLT_UNIT,
        "most_v": model.defaults["max_voltage_limit"] * _VOLT_UNIT,
    }


def group_of(phoneme: str) -> str:
    """The group of `GROUPS` that a phoneme's viseme class belongs to."""
    shown = VISEME_OF[phoneme]
    return next(
        name
        for name, (_, _, _, classes) in GROUPS.items()
        if any(VISEME_OF[first] == shown for first in classes)
    )
