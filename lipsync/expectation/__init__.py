"""The face expected for a mouth: its predicted mean motion, given the phonemes known at an instant.

expectation: by networks, from decided phonemes. back_off: a fixed method's share for pairs of
phonemes that training did not have. soft_expectation: from the recogniser's probabilities of
phonemes. All are inference only, with NumPy; lipservo_lab trains them.
"""
