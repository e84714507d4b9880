"""Phonemes become motion: Wei and Deng's AnimPhos.

model (data), training, selection, blending, and the live synthesiser that joins them.
"""
