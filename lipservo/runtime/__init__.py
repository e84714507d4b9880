"""Run a face: turn a request into sound, speech, servo motion and status."""
