"""What this computer can do for a face, for `doctor`: hearing live, the servo loop's rate, a page.

`.ci/arm64 --cost` measures the same work by a clock of instructions (docs/benchmarks.md).
"""

import math
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

from firmware_bridge.bus_kinds import Finding, Severity
from firmware_bridge.clock import ticks
from firmware_bridge.loop.targets import MemoryTargetChannel
from lipservo.runtime.face_speech import FaceSpeech
from lipservo.runtime.motion_options import ChosenMotion, motion_options
from lipservo.runtime.requested_face import RequestedFace
from lipservo.runtime.run_request import CLIP, RunRequest, Sound
from lipservo.runtime.servos.assembly import bridge_for, load_settings, simulated_wire
from lipservo.runtime.sound import entered_sound
from lipservo.runtime.speech.speech import PUBLISH_PERIOD_S
from lipservo.settings.sections import HIGHEST_RATE_HZ, LOWEST_RATE_HZ

#: The first steps build tables that later ones use; they are not counted.
_WARM_UP_S: Final = 0.5
#: The largest share of a core that a process should take: the rest is for other work in between.
_MOST: Final = 0.7
#: Work for a page with one viewer as a share of that for recognition and motion: .041 of a core
#: where these take .23 (`bench face`, x86_64).
_PAGE_RATIO: Final = 0.18
_LESS: Final = "let less run beside it"


@dataclass(frozen=True, slots=True)
class FaceCost:
    """Seconds of work: speech_s for a second of sound, tick_s for a tick of the servo loop."""

    speech_s: float
    tick_s: float


def face_cost(
    config: str, timer_s: Callable[[], float], *, sound: Sound = CLIP, seconds: float = 0.7
) -> FaceCost:
    """Feed a face of one bus `seconds` of a sound, block by block as live; return its cost.

    config: the face's name or YAML path. timer_s: the clock by which work is measured, s. The
    servos are simulated byte by byte, and the simulator's work counts, so a tick costs no more on a
    real bus. Raises UserError for a face that cannot be loaded, BusError for a bus that cannot be
    simulated.
    """
    settings, folder = load_settings(config)
    motion = motion_options(ChosenMotion(), settings.motion, folder)
    requested = RequestedFace(RunRequest(config, sound, motion, quiet=True))
    bus, clock = simulated_wire(settings)
    channel = MemoryTargetChannel()
    costs_s = []
    with requested.live_board() as board, entered_sound(requested.request) as source, bus:
        bridge = bridge_for(settings, bus, channel)
        # By a timer that stands still the recogniser is never too slow, and never computes ahead.
        speech = FaceSpeech(requested, source, channel, board=board, timer_s=lambda: 0.0)
        bridge.start()
        due_s = zero_s = clock.now()
        speech.side.begin(zero_s)
        for time_s, late in ticks(clock, bridge.rate_hz):
            if time_s > zero_s + _WARM_UP_S + seconds:
                break
            began_s = timer_s()
            while due_s <= time_s:
                speech.side.advance(due_s)
                due_s += PUBLISH_PERIOD_S
            spoke_s = timer_s()
            bridge.tick(time_s, late)
            costs_s.append((spoke_s - began_s, timer_s() - spoke_s))
    counted_s = costs_s[round(_WARM_UP_S * bridge.rate_hz) :]
    spoken_s, ticked_s = (sum(each) / len(counted_s) for each in zip(*counted_s, strict=True))
    return FaceCost(spoken_s * bridge.rate_hz, ticked_s)


def within_reach(
    cost: FaceCost, rate_hz: float, n_cores: int | None = os.cpu_count()
) -> Iterator[Finding]:
    """Yield findings on hearing, loop and page, from what a face costs at `rate_hz`, as measured.

    Hearing, loop and page are processes of their own, each on one of `n_cores` at a time.
    """
    # Seconds of processor time in one second, of each of the three processes.
    hearing, loop, page = cost.speech_s, cost.tick_s * rate_hz, _PAGE_RATIO * cost.speech_s
    takes = f"hearing and moving the mouth live takes {hearing:.2f} s a second, measured now"
    if hearing <= _MOST:
        yield Finding(Severity.GOOD, f"{takes}: within reach of this computer")
    else:
        yield Finding(
            Severity.WARNING,
            f"{takes}: "
            + ("little is left" if hearing <= 1.0 else "too much")
            + "; where the recogniser falls behind the jaw alone moves, by loudness",
            _LESS + ", or render the lines before (docs/scripted-lines.md)",
        )
    highest_hz = min(HIGHEST_RATE_HZ, _MOST / cost.tick_s)
    takes = f"the servo loop takes {loop:.2f} s a second at {rate_hz:g} Hz"
    if rate_hz <= highest_hz:
        yield Finding(Severity.GOOD, f"{takes}: up to {highest_hz:.0f} Hz are within reach")
    else:
        is_possible = highest_hz >= LOWEST_RATE_HZ
        remedy = f"`rate_hz: {math.floor(highest_hz)}` in the YAML" if is_possible else _LESS
        yield Finding(Severity.WARNING, f"{takes}: too much", remedy)
    takes = f"a page with one viewer takes about {page:.2f} s a second more, reckoned from that"
    if page <= _MOST and hearing + loop + page <= _MOST * (n_cores or 1):
        yield Finding(Severity.GOOD, f"{takes}: within reach")
    else:
        yield Finding(Severity.WARNING, f"{takes}: too much beside them", "run without a page")
