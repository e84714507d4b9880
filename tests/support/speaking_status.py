"""What a speech side says that has come down to its third recogniser."""

from lipservo.status.face_status import SpeechStatus

SPEECH = SpeechStatus(
    sound="talk.wav",
    recognizer="energy",
    fallback_level=2,
    fallback_reasons=("network: broken", "pocketsphinx: missing"),
    engine="network",
    weights="default",
    strategy="expected",
    settings={"strength": 0.5},
    delay_ms=226.69,
    n_phonemes=12,
    n_lost_sound_blocks=1,
)
