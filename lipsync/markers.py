"""The 47 named markers of the lower face.

39 as in Wei and Deng (the paper gives the number, not the list; this layout is ours) and 8 on the
inner lips, so that closure is measured and not guessed. Numbers are those of the usual 478-point
face mesh.
"""

_REGIONS: tuple[tuple[str, tuple[int, ...]], ...] = (
    ("outer_lip", (61, 39, 37, 0, 267, 269, 291, 405, 314, 17, 84, 181)),
    ("nose", (98, 2, 327)),
    ("jaw", (172, 136, 149, 176, 152, 400, 378, 365, 397)),
    ("chin", (18, 200, 199)),
    ("cheek", (50, 280, 205, 425, 207, 427, 187, 411, 216, 436, 212, 432)),
    ("inner_lip", (78, 82, 13, 312, 308, 317, 14, 87)),
)

#: Face mesh landmark of every marker, in the order that `markers_mm` arrays use.
MARKER_LANDMARKS: tuple[int, ...] = tuple(n for _, numbers in _REGIONS for n in numbers)
MARKER_NAMES: tuple[str, ...] = tuple(f"{region}_{n}" for region, ns in _REGIONS for n in ns)

#: Indices into the 47 of the 20 lip points.
LIP_MARKERS: tuple[int, ...] = tuple(
    index for index, name in enumerate(MARKER_NAMES) if "lip" in name.split("_")
)

#: Their distance is the lip gap: 0 mm where the lips touch.
UPPER_INNER_LIP = MARKER_NAMES.index("inner_lip_13")
LOWER_INNER_LIP = MARKER_NAMES.index("inner_lip_14")
