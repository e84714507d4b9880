"""A face driven for days on a virtual clock: what grows, and what the auditor saw meanwhile."""

import os
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Final

from firmware_bridge.clock import ManualClock
from firmware_bridge.dynamixel.bus import DynamixelBus
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.life_cycle import LifeCycle
from firmware_bridge.loop.report import BridgeSettings
from firmware_bridge.loop.targets import MemoryTargetChannel, ServoTargets
from firmware_bridge.simulator.chain import chain_for
from firmware_bridge.simulator.faults import Fault
from firmware_bridge.simulator.ports import MemoryTransport
from lipservo.runtime.summary import resident_mb
from lipservo_lab.campaigns.auditor import Auditor
from lipservo_lab.campaigns.chain_trials import BAUD_RATE, face
from lipservo_lab.campaigns.fault_campaign import wanted_deg

#: As on a fair bus: now and then a packet is lost or damaged, and the plug is pulled. Leaks show
#: where things go wrong.
FAULTS: Final = (
    Fault("drop_reply", probability=0.001),
    Fault("corrupt_reply", probability=0.0005),
    Fault("unplug", from_s=0.0, every_s=600.0, lasts_s=2.0),
)
#: Memory is first measured after this share of the cycles, when everything is loaded and warm.
_WARM_SHARE: Final = 0.1
_REPORTS: Final = 100


@dataclass(frozen=True, slots=True)
class Endurance:
    """Figures of a run so far. Memory is resident, in MB (10^6 bytes), of this process.

    cycles: ticks done; moving to rest afterwards is watched too, but not counted. *_at_tenth: after
    a tenth of the ticks, when all was warm; 0: not yet. cpu_s: processor time. goals_outside_limits
    to armed_wrongly: see `Auditor`; contention: two senders on the wire at once. None of these may
    happen. replugs: how often the bus was unplugged.
    """

    cycles: int
    virtual_hours: float
    cpu_s: float
    rss_mb_at_tenth: float
    rss_mb_at_end: float
    descriptors_at_tenth: int
    descriptors_at_end: int
    goals: int
    goals_outside_limits: int
    steps_above_clamp: int
    motion_too_fast: int
    moved_outside: int
    armed_wrongly: int
    contention: int
    replugs: int


#: Counts of `Endurance` that must all be 0.
MUST_NOT: Final = (
    "goals_outside_limits",
    "steps_above_clamp",
    "motion_too_fast",
    "moved_outside",
    "armed_wrongly",
    "contention",
)


def endure(
    n_cycles: int,
    progress: Callable[[Endurance], None],
    *,
    n_servos: int = 5,
    rate_hz: float = 100.0,
    seed: int = 1,
    stopped: Callable[[], bool] = lambda: False,
) -> Endurance:
    """Drive simulated servos for `n_cycles` ticks, byte by byte, through bus, bridge and limits.

    Ends early, with the figures so far, when `stopped` returns true or at Ctrl-C. progress: called
    a hundred times with the figures so far.
    """
    servos = face(n_servos)
    clock = ManualClock()
    chain = chain_for(servos, BAUD_RATE, faults=FAULTS, seed=seed)
    auditor = Auditor(servos, 1.0 / rate_hz)
    auditor.watch(chain)
    bus = DynamixelBus(
        servos, lambda: MemoryTransport(chain, clock, BAUD_RATE, tap=auditor.see), strict=False
    )
    channel = MemoryTargetChannel()
    joints = [servo.joint for servo in servos]
    bridge = Bridge(bus, joints, channel, BridgeSettings(rate_hz, tolerant=True))
    warm_at, report_every = int(n_cycles * _WARM_SHARE), max(1, n_cycles // _REPORTS)
    warm, start_s, n_done = (0.0, 0), time.process_time(), 0

    def so_far() -> Endurance:
        """Return the figures so far; virtual time in hours, processor time in s."""
        return Endurance(
            cycles=n_done,
            virtual_hours=clock.now() / 3600.0,
            cpu_s=time.process_time() - start_s,
            rss_mb_at_tenth=warm[0],
            rss_mb_at_end=resident_mb(),
            descriptors_at_tenth=warm[1],
            descriptors_at_end=open_descriptors(),
            goals=auditor.goals,
            goals_outside_limits=auditor.goals_outside,
            steps_above_clamp=auditor.steps_too_long,
            motion_too_fast=auditor.too_fast,
            moved_outside=auditor.moved_outside,
            armed_wrongly=auditor.armed_wrongly,
            contention=chain.counts.contention,
            replugs=bridge.counts.n_unplugged,
        )

    with bus, LifeCycle(bridge, clock) as life:
        life.start()
        for time_s, late in life.ticks():
            if n_done == warm_at:
                warm = resident_mb(), open_descriptors()
            if n_done % report_every == 0:
                progress(so_far())
            if n_done >= n_cycles or stopped():
                break
            channel.publish(ServoTargets(time_s, wanted_deg(time_s, n_servos)))
            bridge.tick(time_s, late)
            n_done += 1
    return so_far()


def open_descriptors() -> int:
    """Return how many files, pipes and sockets this process has open; 0 without /proc."""
    try:
        return len(os.listdir("/proc/self/fd")) - 1  # the one that lists them
    except OSError:
        return 0


#: A mouth needs no more servos; more cost time, and would leak nothing else.
N_SERVOS, RATE_HZ = 5, 100.0


def endurance_figures(
    n_cycles: int, progress: Callable[[int], None], stopped: Callable[[], bool]
) -> dict[str, float | None]:
    """Run `n_cycles`; return what grew, what went wrong on the wire, and how fast it went.

    Growth of memory and of open files is from a tenth of the cycles to the end; None for a run that
    was stopped before. progress: called with the cycles done.
    """
    run = endure(
        n_cycles,
        lambda so_far: progress(so_far.cycles),
        n_servos=N_SERVOS,
        rate_hz=RATE_HZ,
        stopped=stopped,
    )
    is_warm = run.descriptors_at_tenth > 0
    grown = run.descriptors_at_end - run.descriptors_at_tenth
    return {
        **asdict(run),
        "rss_growth_mb": run.rss_mb_at_end - run.rss_mb_at_tenth if is_warm else None,
        "descriptors_growth": grown if is_warm else None,
        "servos": N_SERVOS,
        "rate_hz": RATE_HZ,
        "cycles_per_cpu_second": run.cycles / max(run.cpu_s, 1e-9),
    }


def what_went_wrong(figures: Mapping[str, float | None]) -> list[str]:
    """Return a line for each count that must be 0 and is not."""
    return [f"{name}: {figures[name]:g}, must be 0" for name in MUST_NOT if figures[name]]
