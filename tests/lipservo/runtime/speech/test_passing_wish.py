"""Somebody who sets half of a wish means all of it."""

from lipservo.runtime.speech.expression import ExpressionRequests
from lipservo.runtime.speech.passing_wish import with_expiry


def test_a_place_to_look_at_is_looked_at():
    wishes = ExpressionRequests(1.0)
    wishes.change(with_expiry({"look_yaw_deg": 20.0}, 5.0))
    assert wishes.look_at_deg == (20.0, 0.0)
    wishes.change(with_expiry({"look_weight": 0.0}, 6.0))
    assert wishes.look_at_deg is None


def test_a_mood_begins_when_it_is_set():
    wishes = ExpressionRequests(1.0)
    wishes.change(with_expiry({"affect_valence": 0.6}, 1000.0))
    assert wishes.affect_at(1000.0) == (0.6, 0.0)
    assert 0.0 < wishes.affect_at(1010.0)[0] < 0.6


def test_what_is_given_and_what_is_no_wish_stay_as_they_are():
    given = {"look_yaw_deg": 1.0, "look_weight": 0.0, "affect_arousal": 1.0, "affect_at_s": 3.0}
    assert with_expiry(given, 9.0) == given
    assert with_expiry({"strength": 0.5}, 9.0) == {"strength": 0.5}
