"""What a speech side says that has come down to its second recogniser."""

from lipservo.runtime.status.face_status import SpeechStatus

SPEECH = SpeechStatus(
    sound="talk.wav",
    recognizer="energy",
    fallback_level=1,
    fallback_reasons=("network: broken",),
    engine="network",
    weights="default",
    strategy="expected",
    settings={"strength": 0.5},
    delay_ms=226.69,
    hears="speech",
    moved_by="text",
    units_shifted_ms=-180.0,
    words=("good", "morning"),
    word=1,
    n_phonemes=12,
    n_lost_sound_blocks=1,
    output="USB Audio",
    output_lost=False,
    listens_on="ws://127.0.0.1:8765",
    speaking="greeting #1",
    n_playout_underruns=2,
    arousal=0.3,
    mouth_closes=False,
    is_resting=False,
    expression={"expression": 1.0},
)
