"""The 478-point face mesh: which points are lips and irises, as MediaPipe lists them."""

N_LANDMARKS = 478

#: Round each lip from the corner on the speaker's right, over the upper lip.
OUTER_LIP = (
    61, 185, 40, 39, 37, 0, 267, 269, 270, 409,
    291, 375, 321, 405, 314, 17, 84, 181, 91, 146,
)  # fmt: skip
INNER_LIP = (
    78, 191, 80, 81, 82, 13, 312, 311, 310, 415,
    308, 324, 318, 402, 317, 14, 87, 178, 88, 95,
)  # fmt: skip
IRISES = tuple(range(468, 478))
