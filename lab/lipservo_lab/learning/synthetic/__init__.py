"""Speech of synthesisers with their own phone times, to train on and to score on. Offline."""
