"""How far apart the faces of two traces of one sound are.

Start:  lipservo replay SOUND --trace a.jsonl
        lipservo replay SOUND --strength 0.8 --trace b.jsonl
        python examples/compare_traces.py a.jsonl b.jsonl

Printed are the largest distances of lips and servos, and how much later the second moves.
`lipservo trace diff` prints more; this is for programs that go on with the figures.
"""

import sys
from pathlib import Path

from lipservo.traces.trace_diff import compare, overlay
from lipservo.traces.trace_file import read_trace
from lipsync.face.model import load_face


def main(first: Path, second: Path) -> None:
    """Lay the second trace over the first by sound time, and print where they differ most."""
    a, b = read_trace(first), read_trace(second)
    face = load_face()
    found = compare(a, b, overlay(a, b, (face, face)), margin_mm=0.5)
    print(f"lips are at most {found.lips_mm:.2f} mm apart")
    worst_deg, servo = max(zip(found.servo_most_deg, a.servos, strict=True))
    print(f"{servo} is at most {worst_deg:.2f} deg off")
    if found.lag_s is None:
        print("one of them does not move")
    else:
        print(f"the second moves {1e3 * found.lag_s:+.1f} ms later")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
