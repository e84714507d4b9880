"""Which vertices of the 478-point face mesh the twin needs by name, beside lips and irises."""

#: Points of the skin; the ten after them are the irises, which lie on no triangle.
N_SKIN = 468

#: The outer rim of the mesh, from the hairline over the left of the face (the picture's right).
FACE_RIM = (
    10, 338, 297, 332, 284, 251, 389, 356, 454, 323, 361, 288, 397, 365, 379, 378, 400, 377,
    152, 148, 176, 149, 150, 136, 172, 58, 132, 93, 234, 127, 162, 21, 54, 103, 67, 109,
)  # fmt: skip

#: Round each eye from its outer corner over the upper lid; the first nine are corner, upper lid,
#: corner. The speaker's own left and right.
RIGHT_EYE = (33, 246, 161, 160, 159, 158, 157, 173, 133, 155, 154, 153, 145, 144, 163, 7)
LEFT_EYE = (263, 466, 388, 387, 386, 385, 384, 398, 362, 382, 381, 380, 374, 373, 390, 249)
N_UPPER_LID = 9

#: Centre of each iris and four points of its edge.
RIGHT_IRIS = (468, 469, 470, 471, 472)
LEFT_IRIS = (473, 474, 475, 476, 477)

#: Lower and upper edge of each eyebrow, from its outer end.
RIGHT_BROW = ((46, 53, 52, 65, 55), (70, 63, 105, 66, 107))
LEFT_BROW = ((276, 283, 282, 295, 285), (300, 293, 334, 296, 336))

#: What follows the lower jaw most nearly: along the chin, 3-dof jaw of `jaw.py`.
CHIN = (152, 176, 400, 148, 377, 199, 200, 175)
#: In front of the ears, near the joint of the jaw.
JAW_JOINT = (234, 454)
