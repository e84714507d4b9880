"""The state tables of docs/architecture.md, made from the code; as a script it writes them anew."""

from places import ROOT

from firmware_bridge.bus import ServoState
from firmware_bridge.loop.face_table import FACE_TABLE, FaceEvent, FaceState
from firmware_bridge.loop.life_table import LIFE_TABLE, LifeEvent, LifeState
from firmware_bridge.loop.servo_table import SERVO_TABLE, ServoEvent
from firmware_bridge.process.supervisor_table import SUPERVISOR_TABLE, Phase, SupervisorEvent

PAGE = ROOT / "docs" / "architecture.md"
BEGIN = "<!-- state tables: tests/support/servos/state_tables.py writes them -->"
END = "<!-- end of the state tables -->"
#: Title, table, states, events; in the order of the page.
_MACHINES = (
    ("A face (`Bridge`)", FACE_TABLE, FaceState, FaceEvent),
    ("Its course in one process (`LifeCycle`)", LIFE_TABLE, LifeState, LifeEvent),
    ("One servo (`ServoSupervision`)", SERVO_TABLE, ServoState, ServoEvent),
    ("The supervisor (`Supervisor`)", SUPERVISOR_TABLE, Phase, SupervisorEvent),
)


def _word(state):
    """A state's name; those of numbers and of whole sentences by their names in the code."""
    by_value = isinstance(state, (FaceState, LifeState))
    return state.value if by_value else state.name.lower().replace("_", " ")


def _row(row):
    """What one row does, as `if GUARD: **new state**; actions`."""
    then = [] if row.then is None else [f"**{_word(row.then)}**"]
    done = "; ".join([*then, *(action.value for action in row.do)])
    return done if row.when is None else f"if {row.when.value}: {done}"


def _table(title, table, states, events):
    cells = {(state, event): rows for state, event, rows in table.cells()}
    lines = [
        f"*{title}*",
        "",
        "| | " + " | ".join(_word(state) for state in states) + " |",
        "|---" * (len(states) + 1) + "|",
    ]
    for event in events:
        row = [
            "<br>".join(_row(each) for each in cells.get((state, event), ())) for state in states
        ]
        lines.append(f"| {event.value} | " + " | ".join(row) + " |")
    return "\n".join(lines)


def state_tables():
    """The text between the two markers of the page."""
    return "\n\n".join(_table(*machine) for machine in _MACHINES)


def page_with_tables(text):
    """The page, with tables as the code has them."""
    before, rest = text.split(BEGIN)
    return f"{before}{BEGIN}\n\n{state_tables()}\n\n{END}{rest.split(END)[1]}"


if __name__ == "__main__":
    PAGE.write_text(page_with_tables(PAGE.read_text("utf-8")), "utf-8")
