"""Drawn mouths beside our lips: when they close, as figures and as a picture."""
