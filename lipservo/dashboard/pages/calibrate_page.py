"""The page of the calibration: how good the present one is, and the steps to a better one."""

from collections.abc import Mapping
from html import escape
from typing import Any, Final

from lipservo_client.protocol import FaceError

from lipservo.dashboard.face_files import calibration_values
from lipservo.dashboard.pages.page_facts import settings_of
from lipservo.dashboard.pages.page_frame import STATIC_URL, card, command, grid, html
from lipsync.phonemes import VISEME_CLASSES

#: The error of a full bar; greater ones are drawn as this, and shown as a number.
_WORST_DEG: Final = 3.0
#: Bars are amber above a third of that, red above two thirds. Our own choice: 1 degree of a servo
#: horn of 8 mm is 0.14 mm of lip.
_AMBER, _RED = 1 / 3, 2 / 3
#: A viseme class with a smaller share of its shapes within reach is shown as a warning, as by
#: `lipservo calibrate show`.
_WELL_REACHED: Final = 0.9


JsonObject = Mapping[str, Any]


def read_calibration(config: str | None) -> tuple[JsonObject | None, str | None]:
    """Return (values, None) of the face's calibration, or (None, reason) where there is none."""
    try:
        return calibration_values(config), None
    except FaceError as error:
        return None, str(error)


def calibrate_page(config: str | None, values: JsonObject | None, trouble: str | None) -> None:
    """Draw the page from `values` of the calibration; if None, show the reason in `trouble`.

    config: the face's name or YAML path, for the commands; None: not known. values, trouble: as
    from `read_calibration`.
    """
    if values is not None and not values["fits_the_face"]:
        trouble = "the face has changed since it was calibrated: calibrate it again"
    with card("Present calibration", _origin_text(values)):
        if trouble is not None:
            html(f'<p class="note warn">{escape(_as_sentence(trouble))}</p>')
        if values is not None:
            html(_summary_html(values["hold_out"]), "facts-row")
    if values is not None:
        with grid("two-columns"):
            with card("Joints", "error on motion left out of the fit"):
                html("".join(_joint_bar_html(*each) for each in values["servos"].items()))
            with card("Mouth shapes", "how much of each is within reach", "coverage"):
                html(_shape_bars_html(values))
    with card("A new calibration", "in a terminal at the face's computer; stop the face first"):
        settings = settings_of(config)
        has_place = settings is None or settings.capabilities.place
        html(steps_of(config or "FACE", has_place=has_place), "steps")


def _as_sentence(text: str) -> str:
    return text[:1].upper() + text[1:].rstrip(".") + "."


def _origin_text(values: JsonObject | None) -> str:
    if values is None:
        return "none"
    made = f", {values['poses']} poses" if values["poses"] else ""
    dated = f", {values['date']}" if values["date"] else ""
    return f"{values['file']}: {values['method']}{made}{dated}"


def _summary_html(errors: JsonObject) -> str:
    """Return HTML of a calibration's lip error and its gap of closed lips, both in mm.

    errors: `hold_out` of `calibrate show --json`, measured on motion left out of the fit. A figure
    that was not measured is shown as `?`.
    """
    is_measured = errors["n_frames"] > 0
    has_closures = is_measured and errors["n_closures"] > 0
    facts = (
        ("lips", "off the shape wanted, rms", errors["lip_rms_mm"] if is_measured else None),
        (
            "closed lips",
            "at most this far apart in 95 % of closures",
            errors["closed_gap_mm"] if has_closures else None,
        ),
    )
    return "".join(
        f'<div class="fact"><b>{_figure_text(value, 2, "mm")}</b><span>{name}</span>'
        f"<small>{hint}</small></div>"
        for name, hint, value in facts
    )


def _joint_bar_html(name: str, values: JsonObject) -> str:
    """Return HTML of a bar for a joint's rms error in degrees, 3 degrees at full length.

    Behind it are the joint's range, and lag, bandwidth and backlash of its servo where known.
    values: of the joint, as in `calibrate show --json`.
    """
    error_deg = values["hold_out_rms_deg"]
    share = 0.0 if error_deg is None else min(1.0, error_deg / _WORST_DEG)
    tone = "bad" if share > _RED else "warn" if share > _AMBER else "good"
    min_deg, max_deg = values["range_deg"]
    notes = [f"{min_deg:g} to {max_deg:g}°"]
    for key, text in _FOLLOWING:
        if values[key]:
            notes.append(text.format(values[key]))
    return _bar_html(name.replace("_", " "), share, tone, _figure_text(error_deg, 2, "°"), notes)


def _shape_bars_html(values: JsonObject) -> str:
    """Return HTML of bars for the measured or trimmed viseme classes, and how to trim a shape.

    values: the calibration, as in `calibrate show --json`, with `coverage` and `trim` by the first
    phoneme of each class.
    """
    classes = [
        row for row in VISEME_CLASSES if row[0] in values["coverage"] or row[0] in values["trim"]
    ]
    rows = [_shape_bar_html(viseme, values) for viseme in classes]
    if not values["coverage"]:
        rows.append('<p class="hint">This way of calibrating does not measure reach.</p>')
    if not values["trim"]:
        rows.append("<p>No shape is trimmed.</p>")
    command_line = f"lipservo calibrate trim {values['file']} P jaw -1"
    rows.append(
        "<p>A shape that looks wrong is trimmed: degrees that are added while its sounds are "
        f"spoken.</p>{command(command_line)}"
    )
    return "".join(rows)


def _shape_bar_html(phonemes: tuple[str, ...], values: JsonObject) -> str:
    """Return HTML of a bar for one viseme class: the share of its shapes within the robot's reach.

    Behind it are the rms distance to the shapes wanted, in mm, and trims. values: the calibration.
    """
    coverage = values["coverage"].get(phonemes[0])
    trims = values["trim"].get(phonemes[0], {})
    notes = [] if coverage is None else [f"{coverage['off_mm']:.2f} mm off"]
    if trims:
        added = (f"{name.replace('_', ' ')} {deg:+g}°" for name, deg in trims.items())
        notes.append(f"trim: {', '.join(added)}")
    share = None if coverage is None else coverage["reachable"]
    tone = "good" if share is None or share >= _WELL_REACHED else "warn"
    value = "?" if share is None else f"{share:.0%}"
    return _bar_html(" ".join(phonemes), share or 0.0, tone, value, notes)


def _bar_html(name: str, share: float, tone: str, value: str, notes: list[str]) -> str:
    return (
        f'<div class="bar-row {tone}"><span class="name">{escape(name)}</span>'
        f'<span class="track"><i style="width:{100 * share:.1f}%"></i></span>'
        f'<b class="value">{value}</b><small>{escape(" · ".join(notes))}</small></div>'
    )


def _figure_text(value: float | None, places: int, unit: str) -> str:
    gap = "" if unit == "°" else " "
    return "?" if value is None else f"{value:.{places}f}{gap}{unit}"


#: How a servo follows its goal, in words, where that is known and not 0.
_FOLLOWING: Final = (
    ("lag_ms", "{:.0f} ms late"),
    ("bandwidth_hz", "up to {:.0f} Hz"),
    ("backlash_deg", "{:.1f}° of play"),
)
#: Picture (symbol of static/steps.svg), heading, what happens, command.
STEPS: Final[tuple[tuple[str, str, str, str], ...]] = (
    (
        "rehearse", "Rehearse", "On a simulated robot of which nothing is known: the whole path in "
        "minutes, and nothing can break.",
        "lipservo calibrate practise 3 -o /tmp/practice.yaml",
    ),
    (
        "limits", "Find the limits", "The servos are let go: turn each joint by hand to both of "
        "its ends. Their places are shown; w writes the limits into the YAML, 2 degrees inside.",
        "lipservo jog --limp --config {face} --port DEV",
    ),
    (
        "look", "By eye, without a camera", "The speaker's mouth is shown; with keys you bring the "
        "robot's mouth into 14 shapes. Usable, but coarse.",
        "lipservo calibrate guided --config {face} --port DEV -o mine.yaml",
    ),
    (
        "dots", "Or measured, with dots on the face", "A tracker sees dots on the lips while the "
        "robot goes through 110 to 150 poses, slowly and within its limits.",
        "lipservo calibrate measure --config {face} --port DEV --tracker markers.csv -o mine.yaml",
    ),
    (
        "late", "How late each servo is", "Each joint chirps for 14 seconds; from then on it is "
        "asked that much earlier.",
        "lipservo calibrate lags mine.yaml --config {face} --port DEV",
    ),
    (
        "check", "Look at the result", "Errors, reach and trims, as above. Name the file in the "
        "face's YAML under calibration, and start the face again.",
        "lipservo calibrate show mine.yaml --config {face}",
    ),
)  # fmt: skip
#: Steps that replace those of `STEPS` where servos cannot report their positions.
PULSE_STEPS: Final = {
    "limits": (
        "limits", "Find the limits", "Arm the sliders of the page Servos and lead each joint to "
        "where it should stop, slowly. Set as min, neutral and max write it into the YAML.",
        "lipservo jog --dashboard --config {face} --port DEV",
    ),
    "late": (
        "late", "How late each servo is", "These servos cannot say it. Film one with a telephone "
        "in slow motion beside the pulse that jog prints, count, and type the milliseconds.",
        "lipservo calibrate lags mine.yaml --config {face} --lag-ms jaw=60",
    ),
}  # fmt: skip


def steps_of(face: str, *, has_place: bool) -> str:
    """Return the steps to calibrate a face, as HTML. has_place: its servos report positions.

    face: its name or YAML path, as the commands take it.
    """
    replaced = {} if has_place else PULSE_STEPS
    steps = (replaced.get(step[0], step) for step in STEPS)
    return "<ol>" + "".join(_step_html(face, *step) for step in steps) + "</ol>"


def _step_html(face: str, picture: str, title: str, text: str, command_line: str) -> str:
    step_text = command_line.format(face=face)
    return (
        f'<li><svg viewBox="0 0 120 80" aria-hidden="true"><use '
        f'href="{STATIC_URL}/steps.svg#{picture}"/></svg><h3>{escape(title)}</h3>'
        f"<p>{escape(text)}</p>{command(step_text)}</li>"
    )
