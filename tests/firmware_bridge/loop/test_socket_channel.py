import numpy as np
import pytest

from firmware_bridge.loop.targets import ServoTargets, SocketTargetChannel, channel_pair


@pytest.fixture
def ends():
    writer, reader = channel_pair()
    with writer, reader:
        yield SocketTargetChannel(writer), SocketTargetChannel(reader)


def test_records_arrive_once_in_order_and_unchanged(ends):
    writer, reader = ends
    for n in range(20):
        writer.publish(ServoTargets(n / 100, np.array([n, -n / 3, np.nan])))
    records = reader.drain()

    assert [record.time_s for record in records] == [n / 100 for n in range(20)]
    np.testing.assert_array_equal(records[7].positions_deg, [7.0, -7 / 3, np.nan])
    assert reader.drain() == []


def test_a_flood_never_blocks_the_writer_and_the_gap_is_counted(ends):
    writer, reader = ends
    for n in range(13_000):
        writer.publish(ServoTargets(float(n), np.zeros(20)))
    while reader.drain():
        pass
    writer.publish(ServoTargets(0.0, np.zeros(20)))
    (after,) = reader.drain()

    assert after.time_s == 0.0
    assert writer.n_dropped == reader.n_dropped > 0


def test_the_reader_learns_that_the_writer_has_died(ends):
    writer, reader = ends
    writer._end.close()

    assert reader.drain() == []
    assert reader.closed


def test_a_writer_outlives_its_reader(ends):
    writer, reader = ends
    reader._end.close()
    writer.publish(ServoTargets(0.0, np.zeros(3)))

    assert writer.n_dropped == 1
