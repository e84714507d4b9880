"""Sound becomes phonemes, live: recognisers behind `lipsync.phonemes.LiveRecognizer`."""
