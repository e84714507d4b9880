"""The face expected for a mouth, given the phonemes known at an instant.

articulation (features of each phoneme's mouth), context (what is known at an instant), expectation
(context to face, NumPy only), training (scikit-learn, offline).
"""
