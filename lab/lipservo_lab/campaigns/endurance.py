"""A face driven for days on a virtual clock: what grows, and what the wire saw in the meantime."""

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from firmware_bridge.clock import ManualClock
from firmware_bridge.dynamixel.bus import DynamixelBus
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.channel import MemoryTargetChannel
from firmware_bridge.loop.life_cycle import LifeCycle
from firmware_bridge.loop.settings import BridgeSettings
from firmware_bridge.simulator.face import chain_for
from firmware_bridge.simulator.faults import Fault
from firmware_bridge.simulator.memory_transport import MemoryTransport
from firmware_bridge.targets import ServoTargets
from lipservo_lab.campaigns.auditor import Auditor
from lipservo_lab.campaigns.fault_campaign import BAUD_RATE, face, wanted_deg

#: As on a fair bus: now and then a packet is lost or spoilt, and the plug is pulled now and then.
#: Whatever leaks, leaks where things go wrong.
FAULTS: Final = (
    Fault("drop_reply", probability=0.001),
    Fault("corrupt_reply", probability=0.0005),
    Fault("unplug", from_s=0.0, every_s=600.0, lasts_s=2.0),
)
#: Once so many cycles are over, everything is loaded and warm: memory is first looked at.
_WARM_SHARE: Final = 0.1
_REPORTS: Final = 100


@dataclass(frozen=True, slots=True)
class Endurance:
    """What a run has shown so far. Memory is resident, in MB (10^6 bytes), of this process.

    cycles: ticks that were asked for and done; bringing the face to rest afterwards is watched,
    too, and not counted. *_at_tenth: once a tenth of them was over and all was warm; 0 = not yet.
    cpu_s: processor time. goals_outside_limits .. armed_wrongly: see `Auditor`; contention: two
    voices on the wire at once. None of these may happen.
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
    """Drive simulated servos for `n_cycles` ticks, byte by byte, through bus, bridge and gate.

    Ends early, with what was seen so far, when `stopped` says so or at Ctrl-C.

    progress: called a hundred times with what was seen so far.
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
    warm, begun_s, n_done = (0.0, 0), time.process_time(), 0

    def so_far() -> Endurance:
        return Endurance(
            cycles=n_done,
            virtual_hours=clock.now() / 3600.0,
            cpu_s=time.process_time() - begun_s,
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
            replugs=bridge.status.n_unplugged,
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


def resident_mb() -> float:
    """Resident memory of this process now, MB; 0 where /proc does not tell."""
    try:
        n_pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        return 0.0
    return n_pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def open_descriptors() -> int:
    """How many files, pipes and sockets this process holds open; 0 where /proc does not tell."""
    try:
        return len(os.listdir("/proc/self/fd")) - 1  # the one that lists them
    except OSError:
        return 0
