"""What the mouth is expected to look like, given the phonemes known now.

articulation (what each phoneme asks of the mouth), context (what is known at an instant),
expectation (context to face, NumPy only), training (scikit-learn, offline).
"""
