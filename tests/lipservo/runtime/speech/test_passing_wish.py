"""Somebody who sets half of a wish means all of it."""

from lipservo.runtime.speech.expression import ExpressionWishes
from lipservo.runtime.speech.passing_wish import whole_wish


def test_a_place_to_look_at_is_looked_at():
    wishes = ExpressionWishes(1.0)
    wishes.change(whole_wish({"look_yaw_deg": 20.0}, 5.0))
    assert wishes.look_at_deg == (20.0, 0.0)
    wishes.change(whole_wish({"look_weight": 0.0}, 6.0))
    assert wishes.look_at_deg is None


def test_a_mood_begins_when_it_is_set():
    wishes = ExpressionWishes(1.0)
    wishes.change(whole_wish({"affect_valence": 0.6}, 1000.0))
    assert wishes.affect_at(1000.0) == (0.6, 0.0)
    assert 0.0 < wishes.affect_at(1010.0)[0] < 0.6


def test_what_is_given_and_what_is_no_wish_stay_as_they_are():
    given = {"look_yaw_deg": 1.0, "look_weight": 0.0, "affect_arousal": 1.0, "affect_at_s": 3.0}
    assert whole_wish(given, 9.0) == given
    assert whole_wish({"strength": 0.5}, 9.0) == {"strength": 0.5}
