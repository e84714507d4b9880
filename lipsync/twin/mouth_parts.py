"""Teeth, tongue and the inside of the mouth: simple shapes that are generated, not measured."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lipsync.arrays import Array, Indices
from lipsync.twin.jaw import on_jaw
from lipsync.twin.part import Part

_ENAMEL, _GUMS, _TONGUE = (0.93, 0.91, 0.86), (0.62, 0.30, 0.30), (0.66, 0.30, 0.31)
_INSIDE_FRONT, _INSIDE_BACK = np.array([0.42, 0.15, 0.15]), np.array([0.07, 0.02, 0.02])
#: Width of the teeth of one side from the middle on, and their height, mm: usual sizes.
_UPPER_WIDTHS_MM, _UPPER_HEIGHT_MM = (8.4, 6.6, 7.6, 7.0, 6.8, 9.8), 9.5
_LOWER_WIDTHS_MM, _LOWER_HEIGHT_MM = (5.4, 5.9, 6.8, 7.0, 7.1, 10.0), 8.5
_THICKNESS_MM = 5.0
#: Edges of the front teeth, and middle of the tongue, from between the lips.
_UPPER_AT_MM, _LOWER_AT_MM = np.array([0.0, -1.6, -5.0]), np.array([0.0, -1.4, -7.4])
_TONGUE_AT_MM = np.array([0.0, -8.5, -32.0])
#: The arch of the teeth is a parabola: so deep at so far from the middle.
_ARCH_HALF_WIDTH_MM, _ARCH_DEPTH_MM = 25.0, 33.0
#: Rows of the inside of the mouth, and its half axes at its widest.
_ROWS, _INSIDE_MM = 9, (24.0, 15.0)


@dataclass(frozen=True, slots=True)
class MouthFrame:
    """Where the mouth is.

    places_mm (n, 3): the inner rim of the lips, in order; morphs: its displacements (n, 3).
    middle_mm: between both lips. joint_mm: of the jaw. jaw: its motion (3,) in each morph.
    """

    places_mm: Array
    morphs: Mapping[str, Array]
    middle_mm: Array
    joint_mm: Array
    jaw: Mapping[str, Array]

    def with_jaw(self, places_mm: Array) -> dict[str, Array]:
        """Displacements of places on the lower jaw, by morph."""
        return {
            name: on_jaw(places_mm, self.joint_mm, motion[None])[0]
            for name, motion in self.jaw.items()
        }


def mouth_parts(frame: MouthFrame) -> tuple[Part, ...]:
    """Upper teeth, lower teeth with tongue, and the inside of the mouth."""
    upper_at = frame.middle_mm + _UPPER_AT_MM
    lower_at = frame.middle_mm + _LOWER_AT_MM
    upper = _dental_arch(upper_at, _UPPER_WIDTHS_MM, _UPPER_HEIGHT_MM, 1.0)
    lower = _dental_arch(lower_at, _LOWER_WIDTHS_MM, _LOWER_HEIGHT_MM, -1.0)
    tongue = _ball(frame.middle_mm + _TONGUE_AT_MM, (16.0, 6.0, 23.0), _TONGUE)
    places, triangles, colours = _joined([lower, tongue])
    return (
        Part("teeth_upper", *upper),
        Part("teeth_lower", places, triangles, colours, frame.with_jaw(places)),
        _inside(frame),
    )


Piece = tuple[Array, Indices, Array]


def _dental_arch(at: Array, widths_mm: tuple[float, ...], height_mm: float, up: float) -> Piece:
    """Teeth of both sides and their gum; `at`: the edge of the front teeth, in the middle."""
    pieces = []
    edges = np.concatenate([[0.0], np.cumsum(widths_mm)])
    for side in (-1.0, 1.0):
        for start, width in zip(edges, widths_mm, strict=False):
            x, z, turn = _on_arch(side * (start + width / 2))
            shorter = 1.0 - 0.03 * start / 8.0
            half = (width * 0.49, height_mm * shorter / 2, _THICKNESS_MM / 2)
            tooth, triangles, colours = _ball(np.zeros(3), half, _ENAMEL, roundness=0.45)
            tooth = tooth @ np.array(
                [[np.cos(turn), 0, -np.sin(turn)], [0, 1, 0], [np.sin(turn), 0, np.cos(turn)]]
            )
            middle = at + np.array([x, up * height_mm / 2, z])
            pieces.append((tooth + middle, triangles, colours))
    pieces.append(_gum(at + np.array([0.0, up * (height_mm + 1.0), 0.0]), float(edges[-1])))
    return _joined(pieces)


def _on_arch(along_mm: float) -> tuple[float, float, float]:
    """x, z and heading of the parabola at an arc length from its middle."""
    bend = _ARCH_DEPTH_MM / _ARCH_HALF_WIDTH_MM**2
    x = np.linspace(0.0, 2 * _ARCH_HALF_WIDTH_MM, 400)
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(bend * x**2)))])
    here = float(np.interp(abs(along_mm), arc, x)) * np.sign(along_mm)
    return here, -bend * here**2, float(np.arctan(2 * bend * here))


def _gum(at: Array, half_length_mm: float) -> Piece:
    """A round bar along the arch."""
    stations = np.linspace(-half_length_mm, half_length_mm, 25)
    round_it = np.linspace(0, 2 * np.pi, 10, endpoint=False)
    rows = []
    for each in stations:
        x, z, turn = _on_arch(float(each))
        across = np.array([np.sin(turn), 0.0, np.cos(turn)])
        rows.append(
            at + np.array([x, 0.0, z]) + 2.9 * np.outer(np.cos(round_it), across)
            + 3.2 * np.outer(np.sin(round_it), (0.0, 1.0, 0.0))
        )  # fmt: skip
    places = np.concatenate(rows)
    triangles = _grid(len(stations), len(round_it))
    return places, triangles, np.broadcast_to(_GUMS, places.shape)


def _ball(
    middle: Array,
    half_mm: tuple[float, float, float],
    colour: tuple[float, ...],
    roundness: float = 1.0,
) -> Piece:
    """A superellipsoid: an ellipsoid at roundness 1, a box with round edges below."""
    up = np.linspace(-np.pi / 2, np.pi / 2, 9)
    about = np.linspace(0, 2 * np.pi, 16, endpoint=False)

    def shaped(values: Array) -> Array:
        return np.asarray(np.sign(values) * np.abs(values) ** roundness, dtype=np.float64)

    ring = shaped(np.cos(up))[:, None]
    unit = np.stack(
        [
            ring * shaped(np.sin(about)),
            np.broadcast_to(shaped(np.sin(up))[:, None], (len(up), len(about))),
            ring * shaped(np.cos(about)),
        ],
        axis=-1,
    ).reshape(-1, 3)
    places = middle + unit * half_mm
    return places, _grid(len(up), len(about)), np.broadcast_to(colour, places.shape)


def _inside(frame: MouthFrame) -> Part:
    """From the inner rim of the lips backwards, wider than the lips, to a dark end.

    Its front moves with the lips, its lower back with the jaw, its upper back not at all.
    """
    n = len(frame.places_mm)
    lips = frame.places_mm
    angle = np.arctan2((lips[:, 1] - frame.middle_mm[1]) * 8.0, lips[:, 0] - frame.middle_mm[0])
    oval = np.column_stack([np.cos(angle) * _INSIDE_MM[0], np.sin(angle) * _INSIDE_MM[1]])
    back = np.column_stack([oval, np.full(n, -48.0)]) + frame.middle_mm
    places, share, colours = [], [], []
    for row in range(_ROWS):
        along = row / (_ROWS - 1)
        opened = min(1.0, along * 2.5)
        shape = (1 - opened) * lips + opened * back
        shape[:, 2] = (1 - along) * lips[:, 2] + along * back[:, 2]
        narrow = 1.0 if along < 0.75 else 4.0 * (1.0 - along)
        shape[:, :2] = frame.middle_mm[:2] + narrow * (shape[:, :2] - frame.middle_mm[:2])
        places.append(shape)
        share.append(np.full(n, max(0.0, 1.0 - along * 2.5)))
        fade = min(1.0, along * 1.6)
        colours.append(np.broadcast_to((1 - fade) * _INSIDE_FRONT + fade * _INSIDE_BACK, (n, 3)))
    all_places = np.concatenate(places)
    of_lips = np.concatenate(share)[:, None]
    lower = np.clip(0.5 - 2.0 * np.sin(np.tile(angle, _ROWS)), 0.0, 1.0)[:, None]
    jaw = frame.with_jaw(all_places)
    still = np.zeros_like(all_places)
    morphs = {
        name: of_lips * np.tile(moves, (_ROWS, 1)) + (1 - of_lips) * lower * jaw.get(name, still)
        for name, moves in frame.morphs.items()
    }
    return Part("mouth", all_places, _grid(_ROWS, n)[:, ::-1], np.concatenate(colours), morphs)


def _grid(n_rows: int, n_round: int) -> Indices:
    """Triangles of rows of vertices, each row closed."""
    corner = np.arange(n_rows * n_round).reshape(n_rows, n_round)
    here, above = corner[:-1], corner[1:]
    ahead, above_ahead = np.roll(here, -1, axis=1), np.roll(above, -1, axis=1)
    bands = [np.stack([here, ahead, above], -1), np.stack([ahead, above_ahead, above], -1)]
    return np.concatenate([band.reshape(-1, 3) for band in bands])


def _joined(pieces: list[Piece]) -> Piece:
    first = np.cumsum([0, *(len(places) for places, _, _ in pieces)])
    return (
        np.vstack([places for places, _, _ in pieces]),
        np.vstack([triangles + at for (_, triangles, _), at in zip(pieces, first, strict=False)]),
        np.vstack([colours for _, _, colours in pieces]),
    )
