"""How much each light lights a pixel: colour, nearness to the lamps, and mixtures of them.

A surface shows the light that falls on it times its own colour, so colour alone takes a wooden floor under a cool lamp
for a white one under a warm lamp. So more is weighed:

- **Colour.** The colour of a surface scatters about that of its light. Its likelihood under a light, or under a mixture
  of lights (steps of a quarter; of a half from four lights up), falls with the chord between the two directions in RGB.
- **Surroundings.** The same of the mean radiance around the pixel, to which the brightest surfaces, the ones most likely
  to be white, contribute most. Light changes slowly from place to place, the colours of a carpet do not.
- **Place.** A lamp in view says where light comes from. Distances are not known, so the lamps and the surfaces are put
  on the walls of an ordinary room around the camera; each lamp's intensity then gives what it sheds on every direction
  (cosine and inverse square), besides its part in the light that the room throws back and forth. A mixture is the more
  likely the better it agrees with that.
- **Luminance.** A pixel too bright for a matt surface is a lamp, and has that lamp's colour alone.

The shares of a pixel are the mean over all mixtures, each by its probability. All this stands in two tables, one over
chromaticity and one over the map in cells, so a pixel costs a few multiplications, however large the map.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import cv2
import numba
import numpy as np
import numpy.typing as npt

from uplift.cluster.evidence import Evidence, View

Floats = npt.NDArray[np.float64]
Image = npt.NDArray[np.float32]

# σ of the chord between a colour and its light's: of a pixel, and of the mean radiance around it. Over 36 relit rooms these
# had 92 to 94 % of the light in the right cluster (median), nearest colours 89 %. A pixel's own colour alone (0.10) did as
# well there, but gives every colour of a patterned carpet another light.
SURFACE_SPREAD, AROUND_SPREAD = 0.144, 0.102
AROUND_DEG = 8.0  # σ of the surroundings
PLACE_WEIGHT = (
    1.0  # how much the proxy room counts beside colour: 0, 1 and 2 had about the same median, 1 the best worst
)
# The proxy room, in metres: 4.6 × 4.6 × 2.6, seen from its middle, 1.4 m above the floor.
ROOM_DOWN, ROOM_UP, ROOM_SIDE = 1.4, 1.2, 2.3
NEAREST_M2 = 0.3  # keeps a surface beside a lamp finite: the lamp has a size, and the room is a guess
AMBIENT_PER_INTENSITY = 0.15  # 1/m²: light thrown back by walls of half reflectance, on 60 m² of them
LEAST = 0.03  # no mixture is impossible by place
CELLS = (32, 64)  # of the map, on which places are computed
AROUND_CELLS = (64, 128)  # on which surroundings are
PRIOR_SIZE = (256, 512)  # rows, columns of the table of places
COLOURS = 128  # nodes of the table of colours, along r/(r+g+b) and b/(r+g+b)
KEPT = 256  # answers that are kept for the next pixels of a cell; a power of two


@dataclass(frozen=True, slots=True, eq=False)
class Membership:
    """Tables from which the shares of any pixel follow."""

    shares: Image  # [C, k] mixtures; the first k are the lights alone
    colour: Image  # [COLOURS, COLOURS, C] likelihood over chromaticity
    place: Image  # [rows, columns, C] weight over the map
    luminance_weights: Image  # [3]
    lamp_above: float  # luminance from which a pixel is a lamp


@dataclass(frozen=True, slots=True, eq=False)
class Members:
    """The lights of every pixel [H, W]: `first` has most of it, `second` the next; `weight` is the first's share of both."""

    first: npt.NDArray[np.uint32]
    second: npt.NDArray[np.uint32]
    weight: Image


def mixtures(count: int) -> Floats:
    """Return ways [C, k] to mix `count` lights, each summing to 1, the pure ones first."""
    steps = 4 if count <= 3 else 2
    ways = [way for way in product(range(steps + 1), repeat=count) if sum(way) == steps and max(way) < steps]
    mixed = np.array(ways, np.float64).reshape(-1, count) / steps
    return np.vstack([np.eye(count), mixed])


def membership(
    view: View,
    colours: Floats,
    found: Evidence,
    owner: npt.NDArray[np.int64],
    *,
    luminance_weights: Floats,
    lamp_above: float,
) -> Membership:
    """Return the tables for lights of given `colours` [k, 3], `owner` [P] being the light of each piece of evidence.

    Without lamps in view, or under a sky, places say nothing and all mixtures are equally likely beforehand.
    """
    count = len(colours)
    ways = mixtures(count)
    each = colours / np.maximum(colours @ luminance_weights, 1e-300)[:, np.newaxis]
    lights = _directions(ways @ each)
    axis = (np.arange(COLOURS) + 0.5) / COLOURS
    r, b = np.meshgrid(axis, axis, indexing="ij")
    nodes = _directions(np.stack([r, np.maximum(1.0 - r - b, 0.0), b], axis=-1))
    likelihood = np.exp(_log_likelihood(nodes, lights, SURFACE_SPREAD))
    prior = np.ones((1, 1, len(ways)), np.float32)
    if count > 1:
        logs = _log_likelihood(_directions(_surroundings(view, found)), lights, AROUND_SPREAD)
        if found.direct and view.sky is None:
            near = _nearness(view, found, owner, count)
            agreement = np.tensordot(near, np.log(np.maximum(ways, LEAST)), axes=([0], [1]))
            logs = logs + PLACE_WEIGHT * _enlarged(agreement, AROUND_CELLS)
        prior = _enlarged(np.exp(logs - logs.max(axis=2, keepdims=True)), PRIOR_SIZE)
    return Membership(
        np.ascontiguousarray(ways, np.float32),
        np.ascontiguousarray(likelihood, np.float32),
        prior,
        np.ascontiguousarray(luminance_weights, np.float32),
        float(lamp_above),
    )


def _directions(rgb: Floats) -> Floats:
    out: Floats = rgb / np.maximum(np.sqrt((rgb**2).sum(axis=-1, keepdims=True)), 1e-300)
    return out


def _log_likelihood(colours: Floats, lights: Floats, spread: float) -> Floats:
    """[..., C] of unit vectors [..., 3] under lights [C, 3]; the best is 0, as a colour far from all has its nearest too."""
    chord2 = 2.0 - 2.0 * np.clip(colours @ lights.T, -1.0, 1.0)
    out: Floats = (chord2.min(axis=-1, keepdims=True) - chord2) / (2.0 * spread**2)
    return out


def _surroundings(view: View, found: Evidence) -> Floats:
    """Mean radiance [rows, columns, 3] around each cell of the map, lamps in view left out."""
    rows, columns = AROUND_CELLS
    light = view.rgb.astype(np.float32)
    if found.direct:
        light.reshape(-1, 3)[found.place] = 0.0
    small = cv2.resize(light, (columns, rows), interpolation=cv2.INTER_AREA)
    sigma = AROUND_DEG / 360.0 * columns
    reach = int(np.ceil(3 * sigma))
    padded = np.pad(small, ((0, 0), (reach, reach), (0, 0)), mode="wrap")
    blurred = cv2.GaussianBlur(padded, (2 * reach + 1, 2 * reach + 1), sigma, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(blurred[:, reach:-reach], np.float64)


def _proxy_room(rows: int, columns: int) -> tuple[Floats, Floats, Floats]:
    """Points [N, 3] of the proxy room in every direction, their normals, and their distances [N] from the camera."""
    theta = np.pi * (np.arange(rows) + 0.5) / rows
    phi = 2.0 * np.pi * ((np.arange(columns) + 0.5) / columns - 0.5)
    level = np.sin(theta)[:, np.newaxis]
    up = np.repeat(np.cos(theta)[:, np.newaxis], columns, axis=1)
    ways = np.stack([level * np.sin(phi), up, -level * np.cos(phi)], axis=-1).reshape(-1, 3)
    reach = np.stack(
        [np.full(len(ways), ROOM_SIDE), np.where(ways[:, 1] > 0, ROOM_UP, ROOM_DOWN), np.full(len(ways), ROOM_SIDE)], 1
    )
    until = reach / np.maximum(np.abs(ways), 1e-9)
    wall = np.argmin(until, axis=1)
    distance = until[np.arange(len(ways)), wall]
    normals = np.zeros_like(ways)
    normals[np.arange(len(ways)), wall] = -np.sign(ways[np.arange(len(ways)), wall])
    return ways * distance[:, np.newaxis], normals, distance


def _nearness(view: View, found: Evidence, owner: npt.NDArray[np.int64], count: int) -> Floats:
    """Share [k, rows, columns] of each light in what falls on the cells of the proxy room."""
    rows, columns = CELLS
    points, normals, distance = _proxy_room(rows, columns)
    height, width = view.luminance.shape
    cell = (found.place // width) * rows // height * columns + (found.place % width) * columns // width
    out = np.zeros((count, rows * columns))
    for light in range(count):
        mine = owner == light
        intensity = np.bincount(cell[mine], view.light.ravel()[found.place[mine]], rows * columns) * distance**2
        for source in np.flatnonzero(intensity):
            offset = points[source] - points
            squared = (offset**2).sum(axis=1)
            cosine = np.maximum((offset * normals).sum(axis=1), 0.0) / np.sqrt(squared + 1e-12)
            out[light] += intensity[source] * (cosine / (squared + NEAREST_M2) + AMBIENT_PER_INTENSITY)
    total = out.sum(axis=0)
    shares = np.where(total > 0, out / np.where(total > 0, total, 1.0), 1.0 / count)
    return shares.reshape(count, rows, columns)


def _enlarged(table: Floats, size: tuple[int, int]) -> Image:
    """A table over the cells of the map [rows, columns, C] on a finer grid, smooth across the seam."""
    padded = np.concatenate([table[:, -1:], table, table[:, :1]], axis=1).astype(np.float32)
    height, width = size
    step = width // table.shape[1]
    fine = cv2.resize(padded, (width + 2 * step, height), interpolation=cv2.INTER_LINEAR)
    return np.ascontiguousarray(fine[:, step:-step])


def members(
    image: Image,
    tables: Membership,
    sky: npt.NDArray[np.bool_] | None = None,
    outdoor: int = -1,
    *,
    rank: npt.NDArray[np.int64] | None = None,
) -> Members:
    """Return the lights of every pixel of `image` [H, W, 3]; pixels of the `sky` have the `outdoor` light alone.

    Light i is called `rank[i]`. Black, NaN and infinite pixels have light 0 alone.
    """
    if rank is None:
        rank = np.arange(tables.shares.shape[1])
    shape = image.shape[:2]
    if len(rank) == 1:
        return Members(np.zeros(shape, np.uint32), np.zeros(shape, np.uint32), np.ones(shape, np.float32))
    # the kernel writes every pixel: planes filled here would cost a pass of one thread over 100 MB at 4096 × 2048
    first, second, weight = np.empty(shape, np.uint32), np.empty(shape, np.uint32), np.empty(shape, np.float32)
    _members(
        image,
        np.ascontiguousarray(tables.shares.T),
        tables.colour,
        tables.place,
        tables.luminance_weights,
        np.float32(min(tables.lamp_above, 3e38)),
        rank,
        first,
        second,
        weight,
    )
    if sky is not None and outdoor >= 0:
        first[sky], second[sky], weight[sky] = rank[outdoor], rank[outdoor], 1.0
    return Members(first, second, weight)


# Sums may be taken in any order, so that they run in parallel lanes; the order is the same in every run.
@numba.njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})  # type: ignore[misc,untyped-decorator,unused-ignore]
def _two_greatest(likely, given, lamp):  # type: ignore[no-untyped-def]
    """The two lights that have most of a colour, and the first one's share of both; a lamp has its own light alone."""
    zero, one = np.float32(0.0), np.float32(1.0)
    best, next_best = 0, 0
    most, next_most = -one, -one
    for i in range(given.shape[0]):
        total = likely[i]
        if not lamp:
            total = zero
            for c in range(given.shape[1]):
                total += likely[c] * given[i, c]
        if total > most:
            next_best, next_most = best, most
            best, most = i, total
        elif total > next_most:
            next_best, next_most = i, total
    return best, next_best, one if lamp or most <= zero else most / (most + next_most)


@numba.njit(cache=True, parallel=True, error_model="numpy", fastmath={"reassoc", "contract"})  # type: ignore[misc,untyped-decorator,unused-ignore]
def _members(image, shares, colour, place, weights, lamp_above, rank, first, second, weight):  # type: ignore[no-untyped-def]
    height, width = image.shape[:2]
    rows, columns = place.shape[:2]
    count, ways = shares.shape
    last = colour.shape[0] - 1
    zero, one, huge, nodes = np.float32(0.0), np.float32(1.0), np.float32(3e38), np.float32(colour.shape[0])
    for band in numba.prange(rows):
        top, bottom = (band * height + rows - 1) // rows, ((band + 1) * height + rows - 1) // rows
        given = np.empty((count, ways), np.float32)  # the shares of each light, weighted by place
        # Colours of a cell recur: what was found for one is kept until another cell, or a colour of the same slot, comes.
        known = np.full(KEPT, -1, np.int64)
        known_first, known_second = np.empty(KEPT, np.uint32), np.empty(KEPT, np.uint32)
        known_weight = np.empty(KEPT, np.float32)
        for cell in range(columns):
            left, right = (cell * width + columns - 1) // columns, ((cell + 1) * width + columns - 1) // columns
            if top == bottom or left == right:
                continue
            for i in range(count):
                for c in range(ways):
                    given[i, c] = place[band, cell, c] * shares[i, c]
            for y in range(top, bottom):
                for x in range(left, right):
                    r, g, b = max(image[y, x, 0], zero), max(image[y, x, 1], zero), max(image[y, x, 2], zero)
                    whole = r + g + b
                    if not (whole > zero and whole < huge):
                        first[y, x], second[y, x], weight[y, x] = np.uint32(0), np.uint32(0), one
                        continue
                    to_node = nodes / whole
                    node_r, node_b = min(int(r * to_node), last), min(int(b * to_node), last)
                    lamp = weights[0] * r + weights[1] * g + weights[2] * b > lamp_above
                    what = 2 * ((cell * (last + 1) + node_r) * (last + 1) + node_b) + int(lamp)
                    slot = (what ^ (what >> 7)) & (KEPT - 1)
                    if known[slot] != what:
                        best, next_best, part = _two_greatest(colour[node_r, node_b], given, lamp)
                        known[slot] = what
                        known_first[slot] = np.uint32(rank[best])
                        known_second[slot] = np.uint32(rank[best] if lamp else rank[next_best])
                        known_weight[slot] = part
                    first[y, x], second[y, x], weight[y, x] = known_first[slot], known_second[slot], known_weight[slot]
