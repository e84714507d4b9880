"""Recognition of phonemes in live sound: recognisers behind `lipsync.phonemes.LiveRecognizer`."""
