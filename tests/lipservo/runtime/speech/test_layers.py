"""One owner for each servo, and no jump when it changes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lipservo.runtime.speech.layers import HANDOVER_S, STEEPEST, Claim, Layer, ServoLayers

SERVOS = ("jaw", "corner_left_up", "neck_pitch", "lids")
NEUTRAL_DEG = np.array([0.0, 0.0, 5.0, -3.0])
PERIOD_S = 0.01


def layers() -> ServoLayers:
    return ServoLayers(SERVOS, NEUTRAL_DEG, PERIOD_S)


def claim(owner: ServoLayers, layer: Layer, **wanted_deg: float) -> Claim:
    return Claim(layer, owner.indices(list(wanted_deg)), np.array(list(wanted_deg.values())))


def test_lips_come_before_expression_before_idle_before_neutral():
    servos = layers()
    claims = [
        claim(servos, Layer.LIPS, jaw=1.0),
        claim(servos, Layer.IDLE, jaw=3.0, corner_left_up=3.0, neck_pitch=3.0),
        claim(servos, Layer.EXPRESSION, jaw=2.0, corner_left_up=2.0),
    ]
    assert servos.compose(claims).tolist() == [1.0, 2.0, 3.0, -3.0]
    assert servos.owners == dict(
        zip(SERVOS, (Layer.LIPS, Layer.EXPRESSION, Layer.IDLE, Layer.NEUTRAL), strict=True)
    )


def test_what_one_owner_wants_is_passed_on_to_the_bit():
    servos, rng = layers(), np.random.default_rng(1)
    for wanted_deg in rng.normal(size=(50, 4)):
        everything = Claim(Layer.LIPS, np.arange(4), wanted_deg)
        assert servos.compose([everything]).tobytes() == wanted_deg.tobytes()


def test_a_new_owner_has_a_servo_fully_after_the_time_of_a_hand_over():
    servos = layers()
    servos.compose([claim(servos, Layer.EXPRESSION, neck_pitch=20.0)])
    shown_deg = [servos.compose([])[2] for _ in range(round(HANDOVER_S / PERIOD_S))]
    assert 19.5 < shown_deg[0] < 20.0
    assert shown_deg[-1] == 5.0
    assert all(np.diff(shown_deg) <= 0.0)


def test_a_servo_that_is_not_there_is_refused():
    with pytest.raises(ValueError, match="ear"):
        layers().indices(["ear"])


wishes = st.lists(
    st.dictionaries(
        st.sampled_from([Layer.IDLE, Layer.EXPRESSION, Layer.LIPS]),
        st.dictionaries(st.sampled_from(SERVOS), st.floats(-40.0, 40.0), min_size=1),
    ),
    min_size=1,
    max_size=60,
)


@given(wishes)
def test_no_servo_jumps_when_it_changes_hands_and_none_leaves_what_was_claimed(stream):
    """An owner may move its servo as it likes; a change of owner adds no step of its own."""
    servos, last_deg, last_owned = layers(), None, [None] * len(SERVOS)
    for wished in stream:
        claims = [claim(servos, layer, **wanted) for layer, wanted in wished.items()]
        shown_deg = servos.compose(claims)
        owned = []
        for n, name in enumerate(SERVOS):
            owners = [layer for layer, wanted in wished.items() if name in wanted]
            owner = max(owners, default=Layer.NEUTRAL)
            owned.append((owner, wished[owner][name] if owners else NEUTRAL_DEG[n]))
            assert servos.owners[name] == owner
            if last_deg is None:
                assert shown_deg[n] == owned[n][1]
                continue
            # At most 80 degrees lie between two claims.
            most_deg = 80.0 * STEEPEST * PERIOD_S / HANDOVER_S
            if last_owned[n][0] == owner:
                most_deg += abs(owned[n][1] - last_owned[n][1])
            assert abs(shown_deg[n] - last_deg[n]) <= most_deg + 1e-9
        assert np.abs(shown_deg).max() <= 40.0
        last_deg, last_owned = shown_deg, owned
