"""The furniture of the room. Colours are measured samples of CIE 224:2017 by number, or patches by name."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from samples import transport
from samples.builder import FRONT, TOP, Builder

Float64 = npt.NDArray[np.float64]


def _pick(chance: float, *choices: int) -> int:
    """Return one of several colour samples by a number in (0, 1)."""
    return choices[min(int(chance * len(choices)), len(choices) - 1)]


def add_shell(b: Builder, chance: Float64) -> None:
    """Add walls, floor and ceiling; the wall in front has a colour of its own."""
    wall = b.material(_pick(chance[0], 60, 91, 23))
    accent = b.material(_pick(chance[1], 54, 72, 61, 27, 14))
    room = b.box((-0.04, 1.306, -0.06), (2.65, 1.306, 2.35), wall, grid=14)
    faces = b.boxes[room][3]
    faces[4] = accent
    faces[2] = b.material(_pick(chance[2], 17, 18, 19))
    faces[3] = b.material("white")
    b.texture(room, (2,), transport.PLANKS, b.material(_pick(chance[2], 18, 16, 18)), 0.21)


def add_stand(b: Builder, centre: Float64, axes: Float64) -> None:
    """Add the pole that carries the chart, and its foot."""
    x, y, z = centre - 0.012 * axes[2]
    dark = b.material("black")
    b.box((x, (y - 0.09) / 2, z), (0.009, (y - 0.09) / 2, 0.009), dark)
    b.box((x, 0.011, z), (0.16, 0.010, 0.16), dark, turn_deg=33.0)


def add_furniture(b: Builder, chance: Float64) -> None:
    """Add the furniture. Numbers are metres from the floor's centre."""
    wood, dark_wood = b.material(_pick(chance[3], 17, 19, 16)), b.material(13)
    white, black = b.material("white"), b.material("black")

    rug = b.box(
        (-0.35, 0.007, -0.35), (1.25, 0.006, 0.85), b.material(_pick(chance[4], 7, 71, 52)), grid=6, turn_deg=4.0
    )
    b.texture(rug, (TOP,), transport.CHECKER, b.material(_pick(chance[5], 23, 14, 36)), 0.212)

    # Sofa along the left wall.
    fabric = b.material(_pick(chance[6], 97, 77, 66, 85))
    shift = 0.2 * (chance[7] - 0.5)
    b.box((-2.18, 0.21, 0.55 + shift), (0.42, 0.20, 0.88), fabric, grid=3)
    b.box((-2.53, 0.62, 0.55 + shift), (0.11, 0.27, 0.88), fabric, grid=3)
    b.box((-2.18, 0.36, -0.43 + shift), (0.45, 0.24, 0.10), fabric, grid=3)
    b.box((-2.18, 0.36, 1.53 + shift), (0.45, 0.24, 0.10), fabric, grid=3)
    b.box((-2.33, 0.57, 0.15 + shift), (0.07, 0.19, 0.20), b.material(_pick(chance[8], 25, 42, 20)), turn_deg=12.0)
    b.box((-2.31, 0.57, 1.05 + shift), (0.07, 0.19, 0.20), b.material(_pick(chance[9], 70, 96, 48)), turn_deg=-9.0)

    # Sideboard at the wall in front, with things on it.
    x = -0.55 + 0.2 * (chance[10] - 0.5)
    b.box((x, 0.44, -2.16), (0.80, 0.34, 0.23), wood, grid=4)
    for leg in (-0.72, 0.72):
        b.box((x + leg, 0.05, -2.13), (0.025, 0.05, 0.16), black)
    b.box((x - 0.30, 0.44, -1.927), (0.32, 0.28, 0.004), white, grid=3)
    b.box((x + 0.38, 0.44, -1.927), (0.32, 0.28, 0.004), white, grid=3)
    b.sphere((x - 0.48, 0.9305, -2.14), 0.15, b.material(_pick(chance[11], 76, 57, 10)))
    b.sphere((x - 0.17, 0.8705, -2.10), 0.09, b.material(_pick(chance[12], 24, 70, 98)))
    for i, sample in enumerate((50, 75, 11)):
        b.box((x + 0.45, 0.80 + 0.041 * i, -2.14), (0.15 - 0.01 * i, 0.02, 0.11), b.material(sample), turn_deg=7.0 * i)

    # Pictures: one over the sideboard, one on the right wall.
    b.box((x + 0.05, 1.62, -2.395), (0.46, 0.33, 0.012), dark_wood)
    canvas = b.box((x + 0.05, 1.62, -2.388), (0.41, 0.28, 0.012), b.material(_pick(chance[13], 73, 22, 56)), grid=3)
    b.texture(canvas, (FRONT,), transport.CHECKER, b.material(_pick(chance[14], 26, 33, 70)), 0.137)

    # Table at the right, things on it, and a stool.
    x, z = 1.72 + 0.2 * (chance[15] - 0.5), -1.30 + 0.2 * (chance[16] - 0.5)
    b.box((x, 0.735, z), (0.62, 0.016, 0.40), wood, grid=4)
    for side in (-0.57, 0.57):
        for end in (-0.35, 0.35):
            b.box((x + side, 0.36, z + end), (0.022, 0.358, 0.022), dark_wood)
    for i, sample in enumerate((20, 43, 5, 25)):
        b.sphere((x - 0.38 + 0.12 * i, 0.7915, z + 0.10 - 0.05 * (i % 2)), 0.04, b.material(sample))
    b.sphere((x + 0.22, 0.8915, z - 0.12), 0.14, b.material(_pick(chance[17], 42, 88, 73)))
    b.box(
        (x - 0.12, 0.33, z + 0.75), (0.17, 0.015, 0.17), b.material(_pick(chance[18], 3, 4, 57)), turn_deg=25.0, grid=3
    )
    for side in (-0.12, 0.12):
        b.box((x - 0.12 + side, 0.158, z + 0.75), (0.015, 0.157, 0.12), black, turn_deg=25.0)

    # A door in the right wall.
    b.box((2.597, 1.015, 0.62), (0.012, 1.01, 0.43), b.material(_pick(chance[19], 33, 72, 79)), grid=4)
    b.box((2.585, 1.015, 0.18), (0.025, 1.01, 0.03), white)
    b.box((2.585, 1.015, 1.06), (0.025, 1.01, 0.03), white)
    b.box((2.585, 2.055, 0.62), (0.025, 0.03, 0.47), white)
    b.sphere((2.545, 1.0, 0.30), 0.03, b.material("neutral 5"))

    # A plant in the corner behind on the right.
    b.box((2.12, 0.19, 1.82), (0.17, 0.19, 0.17), b.material(_pick(chance[20], 12, 8, 68)), turn_deg=15.0, grid=3)
    leaves = (
        (0.0, 0.62, 0.0, 0.21),
        (-0.16, 0.50, 0.09, 0.15),
        (0.15, 0.53, -0.10, 0.16),
        (0.03, 0.88, -0.05, 0.16),
        (-0.10, 0.78, -0.12, 0.13),
    )
    for i, (dx, y, dz, radius) in enumerate(leaves):
        b.sphere((2.12 + dx, y, 1.82 + dz), radius, b.material((49, 37, 45, 46, 49)[i]))

    _shelf(b, chance)


def _shelf(b: Builder, chance: Float64) -> None:
    """Add shelves full of books at the wall behind the camera."""
    wood = b.material(_pick(chance[21], 19, 13, 27))
    x, z, depth = -0.35, 2.10, 0.17
    for side in (-0.93, 0.93):
        b.box((x + side, 0.92, z), (0.018, 0.92, depth), wood, grid=3)
    for y in (0.10, 0.62, 1.16, 1.70):
        b.box((x, y, z), (0.912, 0.016, depth), wood, grid=3)
    books = (5, 76, 22, 53, 90, 11, 73, 34, 99, 8, 58, 28, 71, 10, 42, 79, 20, 52, 97, 24, 75)
    place = 0
    for y in (0.636, 1.176):
        left = x - 0.87
        while left < x + 0.62 - 0.5 * chance[22]:
            number = chance[24 + place % 34] if chance[24] != 0.5 else (0.37 + 0.618034 * place) % 1.0
            thick, tall = 0.022 + 0.035 * number, 0.13 + 0.07 * ((5.0 * number) % 1.0)
            b.box(
                (left + thick, y + tall, z - 0.03), (thick - 0.002, tall, 0.11), b.material(books[place % len(books)])
            )
            left += 2.0 * thick
            place += 1
    b.sphere((x + 0.55, 0.2565, z - 0.02), 0.14, b.material(22))
    b.box((x - 0.4, 0.24, z), (0.28, 0.12, 0.12), b.material(68))
