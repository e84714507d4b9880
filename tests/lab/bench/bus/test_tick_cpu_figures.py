"""What `bench bus` times is work: values that the peer sent arrive, and goals that move leave."""

import struct

import numpy as np
import pytest

pytest.importorskip("smbus2")

from lipservo_lab.bench.bus import (
    bus_figures,
    feetech_tick_figures,
    pulse_tick_figures,
    tick_cpu_figures,
)
from lipservo_lab.bench.bus.canned_peer import CannedServos
from lipservo_lab.bench.bus.servo_clients import AnswerLost, SdkClient, canned_peer
from lipservo_lab.bench.bus.tick_cpu_figures import OthersTick, own_tick

from firmware_bridge.dynamixel.wire import codec
from firmware_bridge.dynamixel.wire.codec import FrameParser

#: After so many answers a canned peer begins its motion anew.
N_MOMENTS = 64
IDS = range(1, 21)


@pytest.fixture(scope="module")
def places():
    """The position registers of all servos at each moment that the peer knows."""
    servos = CannedServos(20)
    (question,) = FrameParser().feed(codec.sync_read(IDS, 126, 10, fast=True))
    answers = [codec.split_fast_status(servos.answer(question), 10) for _ in range(N_MOMENTS)]
    return {tuple(struct.unpack("<6xi", each.data)[0] for each in answer) for answer in answers}


@pytest.fixture(scope="module")
def told():
    """Read the canned servos by dynamixel-sdk at each instant; leave out lost answers.

    Each reading: currents, positions, voltages, temperatures, a list of each.
    """
    with canned_peer(20) as port:
        client, found = OthersTick(SdkClient(port, 20)), []
        for n in range(N_MOMENTS):
            client.prepare(n)
            try:
                found.append(client.work())
            except AnswerLost:
                continue
    return found


def test_a_tick_that_is_timed_decodes_what_the_peer_sent_and_sends_what_moves(places, told):
    signs = np.array([1 if n % 2 else -1 for n in range(20)])

    with own_tick() as tick:
        feedbacks, hear = [], tick.bus.feedback
        tick.bus.feedback = lambda: feedbacks.append(hear()) or feedbacks[-1]
        reports = []
        for n in range(80):
            tick.prepare(n)
            reports.append(tick.work())
        heard = {
            tuple(np.rint(2048 + signs * each.positions_deg * 4096 / 360).astype(int).tolist())
            for each in feedbacks
        }
        assert tick.bridge.troubles == ()
        health = tick.bridge.servo_health()

    sent_deg = np.array([report.sent_deg for report in reports])
    assert all(report.torque_on for report in reports)
    assert (np.ptp(sent_deg, axis=0) > 5.0).all()
    assert len(heard) > 20
    assert heard <= places
    assert all((each.age_s == 0.0).all() for each in feedbacks)
    voltages = {value / 10.0 for _, _, voltage, _ in told for value in voltage}
    temperatures = {value for _, _, _, temperature in told for value in temperature}
    assert {each.voltage_v for each in health} <= voltages
    assert {each.temperature_degc for each in health} <= temperatures


def test_the_others_decode_every_servo(places, told):
    for values in told:
        assert [len(each) for each in values] == [20, 20, 20, 20]
    found = {tuple(positions) for _, positions, _, _ in told}
    assert len(found) > 20
    assert found <= places


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shortened", "ratios", "promised"),
    [
        (tick_cpu_figures, tick_cpu_figures.tick_ratios, "cpu_tick_ratio cpu_tick_ratio_median"),
        (
            pulse_tick_figures,
            pulse_tick_figures.pulse_tick_ratios,
            "cpu_pulses_maestro_ratio cpu_tick_maestro_ratio "
            "cpu_pulses_pca9685_ratio cpu_tick_pca9685_ratio",
        ),
        (
            pulse_tick_figures,
            feetech_tick_figures.feetech_tick_ratios,
            "cpu_goals_feetech_ratio cpu_tick_feetech_ratio",
        ),
        (
            bus_figures,
            bus_figures.cpu_ratios,
            "cpu_sync_write_ratio cpu_sync_read_ratio cpu_cycle_ratio",
        ),
    ],
)
def test_the_figures_have_the_names_that_are_promised(monkeypatch, shortened, ratios, promised):
    counts = {"_WARM_UP_BLOCKS": 1, "_BLOCKS": 2}
    for name, n in ({"_ROUNDS": 1, "_CALLS": 2} if shortened is bus_figures else counts).items():
        monkeypatch.setattr(shortened, name, n)
    figures = ratios()

    assert set(promised.split()) <= figures.keys()
    assert all(value > 0.0 for value in figures.values())
