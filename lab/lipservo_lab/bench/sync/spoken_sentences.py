"""Sentences that `bench sync` says: every P, B and M beside many neighbours."""

SENTENCES = (
    "The ship moved past the pier before midnight.",
    "Maybe somebody left an umbrella at the museum.",
    "A hungry bear climbed the apple tree in April.",
    "Put both lamps above the piano, not below it.",
    "Remember to bring pumpkin soup for my grandmother.",
    "Nobody complained about the camping trip in May.",
    "The mayor's speech began with a simple example.",
    "He keeps a pile of broken umbrellas by the pump.",
    "Is it possible to climb that mountain by bicycle?",
    "Seven bumpy buses stopped at the empty market.",
    "My best map shows a small bridge near the camp.",
    "Keep the cabin warm and sweep up the bread crumbs.",
)
