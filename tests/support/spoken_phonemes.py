"""Phonemes as a test says them, and as a recogniser might come to believe them."""

from hypothesis import strategies as st

from lipsync.phonemes import PHONEMES, PhonemeEvent, PhonemeUpdate


def spoken(*phones: tuple[str, float]) -> tuple[PhonemeEvent, ...]:
    """Events one after the other from their durations."""
    events, start_s = [], 0.0
    for phoneme, duration_s in phones:
        events.append(PhonemeEvent(phoneme, start_s, start_s + duration_s))
        start_s += duration_s
    return tuple(events)


@st.composite
def update_streams(draw) -> list[PhonemeUpdate]:
    """Beliefs that change, come late, in bursts, and contradict one another."""
    updates, heard_s = [], 0.0
    for _ in range(draw(st.integers(1, 12))):
        heard_s += draw(st.floats(0.01, 0.5))
        start_s = max(0.0, heard_s - draw(st.floats(0.0, 0.8)))
        final_s = max(0.0, heard_s - draw(st.floats(0.0, 0.6)))
        events, at_s = [], start_s
        for phoneme in draw(st.lists(st.sampled_from(PHONEMES), min_size=1, max_size=5)):
            end_s = at_s + draw(st.floats(0.005, 0.4))
            events.append(PhonemeEvent(phoneme, at_s, end_s))
            at_s = end_s
        if draw(st.booleans()):
            events[-1] = PhonemeEvent(events[-1].phoneme, events[-1].start_s, None)
        updates.append(PhonemeUpdate(start_s, heard_s, final_s, tuple(events)))
    return updates
