"""A face at work: a request becomes sound, speech, servos and status."""
