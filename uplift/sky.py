"""Is there a sky in a lat-long map, and where is it?

Method: Y. Shen and Q. Wang, "Sky Region Detection in a Single Image for Autonomous Ground Robot Navigation", Int. J.
Adv. Robot. Syst. 10 (2013), doi 10.5772/56884: for each of many gradient thresholds the border is the first row of
every column whose gradient exceeds it; the border that makes sky and ground most uniform, in the sense of an energy of
their colour covariances, is kept; three rules then say whether it borders a sky.

Made for lat-long HDR maps by: a tone map that does not depend on the map's scale; gradients that wrap around in x;
statistics weighted by solid angle; the horizon (the sky of an upright map ends at v = 0.5; a border is looked for down
to v = 0.56, for cameras on a hill or a little tilted, and a threshold that meets no edge by then in a tenth of the
columns sees no border at all; the others of these end at the horizon); one more rule of presence, as the ceiling of a room is as smooth as a sky but ends far
above the horizon; and the sun, whose rim ends the sky for the paper, and is put back here.

Left out: skies that nowhere come near the horizon (seen through windows, over a narrow yard, between trees) are not
called a sky.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from uplift import UpliftError

Floats = npt.NDArray[np.float64]
Image = npt.NDArray[np.float32]

WORK_WIDTH = 640
THRESHOLDS = np.arange(5.0, 601.0, 5.0)
GAMMA = 2.0  # how much more the sky's uniformity counts than the ground's (the paper's γ)
HORIZON = 0.5  # of the height
LOWEST = 0.56  # of the height: 10 degrees below the horizon
MAX_OPEN_COLUMNS = 0.1  # share of columns without an edge above LOWEST
NEAR_HORIZON, MIN_NEAR = 0.4, 0.25  # share of columns whose sky reaches below v = 0.4. Rooms: ≤ 0.07, skies: ≥ 0.64
GLARE_STEP = 8  # levels of 255: so much brighter is what ends the sky, if it is a part of it
GLARE_WIDTH = 1 / 8  # of the width: the widest gap that the sun or a cloud may cut into the sky
MIN_MEAN_BORDER = 1 / 30  # of the height (paper)
LOW_BORDER, JAGGED_ROWS = 1 / 4, 5.0  # a border above H/4 on average must be smooth (paper)
PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))  # of channels: a covariance is symmetric
PLACE_OF_PAIR = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
JUMP = 1 / 3  # of the height: a neighbouring column's border that far off starts the last test (paper)


@dataclass(frozen=True, slots=True, eq=False)
class Sky:
    """Whether a map holds a sky, and where."""

    present: bool
    mask: npt.NDArray[np.bool_]  # [H, W]: pixels of the sky, the sun among them; all False if not present
    border: npt.NDArray[np.float64]  # [W]: row at which the sky ends in each column; zeros if not present


@dataclass(frozen=True, slots=True, eq=False)
class _Sums:
    """Sums from the top down to each row: [rows + 1, W] of weight, [.., 3] of colour, [.., 6] of its products."""

    weight: Floats
    colour: Floats
    product: Floats  # of the channels of PAIRS


def find_sky(image: Image, luminance_weights: npt.ArrayLike) -> Sky:
    """Return the sky of a lat-long map.

    Scaling the map changes nothing. A map without any gradient, without light or with no finite pixel has no sky.

    Parameters
    ----------
    image
        Shape [H, W, 3], float32, linear RGB, lat-long, upright (row 0 is the zenith). NaN, infinite and negative
        pixels count as dark.
    luminance_weights
        Shape [3].

    Raises
    ------
    UpliftError
        If the image has another shape.
    """
    image = np.asarray(image, dtype=np.float32)
    if image.ndim != 3 or image.shape[2] != 3 or min(image.shape[:2]) < 1:
        raise UpliftError(f"find_sky: image of shape {image.shape}; expected a lat-long map [H, W, 3]")
    height, width = image.shape[:2]
    small = _tone_mapped(image, np.asarray(luminance_weights, np.float64))
    border = None if small is None else _border(small)
    if small is None or border is None:
        return Sky(False, np.zeros((height, width), np.bool_), np.zeros(width))
    at = ((np.arange(width) + 0.5) * (small.shape[1] / width)).astype(np.int64)
    rows = border[at] * (height / small.shape[0])
    mask = np.arange(height)[:, np.newaxis] + 0.5 < rows
    return Sky(True, mask, rows)


def _tone_mapped(image: Image, luminance_weights: Floats) -> npt.NDArray[np.uint8] | None:
    """The map 640 wide in 8 bit, its average (in the logarithm) at 18 % grey; None if it holds no light."""
    height, width = image.shape[:2]
    size = (WORK_WIDTH, max(4, round(height * WORK_WIDTH / width)))
    way = cv2.INTER_AREA if width > WORK_WIDTH else cv2.INTER_LINEAR
    small = np.asarray(cv2.resize(image, size, interpolation=way), np.float64)
    small = np.where(np.isfinite(small).all(axis=2, keepdims=True), np.maximum(small, 0.0), 0.0)
    luminance = np.maximum(small @ luminance_weights, 0.0)
    lit = luminance > 0
    if not lit.any():
        return None
    weight = np.repeat(_row_weight(size[1])[:, np.newaxis], size[0], axis=1)[lit]
    key = np.exp((np.log(luminance[lit]) * weight).sum() / weight.sum())
    scaled = small * (0.18 / key)
    compressed = scaled / (1.0 + luminance * (0.18 / key))[..., np.newaxis]
    display = np.clip(compressed, 0.0, 1.0) ** (1 / 2.2)
    return np.asarray(np.rint(255.0 * display), np.uint8)


def _row_weight(rows: int) -> Floats:
    edges = np.cos(np.pi * np.arange(rows + 1) / rows)
    out: Floats = edges[:-1] - edges[1:]
    return out


def _gradient(small: npt.NDArray[np.uint8]) -> Floats:
    """Sobel magnitude of the grey image, wrapping in x."""
    grey = cv2.cvtColor(small, cv2.COLOR_RGB2GRAY).astype(np.float64)
    padded = np.pad(grey, ((0, 0), (1, 1)), mode="wrap")
    across = cv2.Sobel(padded, cv2.CV_64F, 1, 0, ksize=3, borderType=cv2.BORDER_REPLICATE)
    down = cv2.Sobel(padded, cv2.CV_64F, 0, 1, ksize=3, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(np.hypot(across, down)[:, 1:-1], np.float64)


def _sums(colours: Floats) -> _Sums:
    weight = np.repeat(_row_weight(len(colours))[:, np.newaxis], colours.shape[1], axis=1)

    def down(values: Floats) -> Floats:
        return np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])

    weighted = colours * weight[..., np.newaxis]
    products = np.stack([weighted[..., i] * colours[..., j] for i, j in PAIRS], axis=-1)
    return _Sums(down(weight), down(weighted), down(products))


def _sky_and_ground(sums: _Sums, border: npt.NDArray[np.int64]) -> list[tuple[float, Floats, Floats]]:
    """(weight, mean [3], covariance [3, 3]) of what lies above and what lies below a border [W]."""
    columns = np.arange(len(border))
    out = []
    for above in (True, False):
        parts = []
        for table in (sums.weight, sums.colour, sums.product):
            top = table[border, columns].sum(axis=0)
            parts.append(top if above else table[-1].sum(axis=0) - top)
        weight = float(parts[0])
        mean = parts[1] / max(weight, 1e-12)
        covariance = parts[2][PLACE_OF_PAIR] / max(weight, 1e-12) - np.outer(mean, mean)
        out.append((weight, mean, covariance))
    return out


def _energy(sums: _Sums, border: npt.NDArray[np.int64]) -> float:
    """The paper's J: the more uniform in colour both sides are, the greater."""
    (_, _, sky), (_, _, ground) = _sky_and_ground(sums, border)
    spread = GAMMA * abs(np.linalg.det(sky)) + abs(np.linalg.det(ground))
    spread += GAMMA * abs(np.linalg.eigvalsh(sky)[-1]) + abs(np.linalg.eigvalsh(ground)[-1])
    return float(1.0 / max(spread, 1e-12))


def _border(small: npt.NDArray[np.uint8]) -> npt.NDArray[np.int64] | None:
    """The best border [W] in rows of the small map, or None if what lies above it is no sky."""
    height = len(small)
    gradient = _gradient(small)
    if gradient.max() < THRESHOLDS[0]:
        return None
    lowest = round(LOWEST * height)
    greatest = np.maximum.accumulate(gradient[:lowest], axis=0)
    sums = _sums(small.astype(np.float64))
    borders: dict[bytes, npt.NDArray[np.int64]] = {}
    for threshold in THRESHOLDS:
        rows = np.count_nonzero(greatest <= threshold, axis=0)
        unmet = rows >= lowest
        if rows.any() and unmet.mean() <= MAX_OPEN_COLUMNS:
            rows = np.where(unmet, round(HORIZON * height), rows)
            borders[rows.tobytes()] = rows
    if not borders:
        return None
    best = max(borders.values(), key=lambda rows: _energy(sums, rows))
    if not _is_sky(best, height):
        return None
    best = _with_the_sun(small, best)
    if np.abs(_steps(best)).max() > JUMP * height:
        best = _without_false_columns(small, sums, best)
    return best


def _steps(border: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    return np.diff(border, append=border[:1])


def _is_sky(border: npt.NDArray[np.int64], height: int) -> bool:
    mean, jagged = border.mean(), np.abs(_steps(border)).mean()
    if mean < MIN_MEAN_BORDER * height or (border > NEAR_HORIZON * height).mean() < MIN_NEAR:
        return False
    return not (mean < LOW_BORDER * height and jagged > JAGGED_ROWS)


def _without_false_columns(
    small: npt.NDArray[np.uint8], sums: _Sums, border: npt.NDArray[np.int64]
) -> npt.NDArray[np.int64]:
    """Keep of two halves of the sky (k-means) the one farther from the ground; drop columns mostly of the other.

    Unlike the paper's, unless that other half is more like the first one than like the ground.
    """
    above = np.arange(len(small))[:, np.newaxis] < border
    colours = small[above].astype(np.float64)
    weight = np.broadcast_to(_row_weight(len(small))[:, np.newaxis], above.shape)[above]
    halves = _two_halves(colours, weight)
    (_, _, _), (_, ground, spread) = _sky_and_ground(sums, border)
    inverse = np.linalg.pinv(spread + np.eye(3))
    offsets = [half - ground for half in halves]
    true = int(offsets[1] @ inverse @ offsets[1] > offsets[0] @ inverse @ offsets[0])
    false = halves[1 - true]
    if ((false - halves[true]) ** 2).sum() < ((false - ground) ** 2).sum():
        return border  # both halves are sky: blue and cloud, zenith and horizon
    nearer = ((colours - halves[true]) ** 2).sum(axis=1) <= ((colours - false) ** 2).sum(axis=1)
    kept = np.zeros(above.shape)
    kept[above] = nearer
    return np.where(2 * kept.sum(axis=0) >= border, border, 0)


def _two_halves(colours: Floats, weight: Floats) -> Floats:
    """Centres [2, 3] of k-means started at the ends of the principal axis."""
    mean = weight @ colours / weight.sum()
    offset = colours - mean
    covariance = (offset * weight[:, np.newaxis]).T @ offset / weight.sum()
    values, vectors = np.linalg.eigh(covariance)
    axis = vectors[:, -1] * np.sqrt(max(values[-1], 0.0))
    centres = np.stack([mean - axis, mean + axis])
    for _ in range(50):
        second = ((colours - centres[1]) ** 2).sum(axis=1) < ((colours - centres[0]) ** 2).sum(axis=1)
        if second.all() or not second.any():
            break
        moved = np.stack([np.average(colours[mine], axis=0, weights=weight[mine]) for mine in (~second, second)])
        if np.abs(moved - centres).max() < 1e-6:
            break
        centres = moved
    return centres


def _with_the_sun(small: npt.NDArray[np.uint8], border: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """The border lowered to its neighbours' where it was something brighter than the sky that ended it."""
    width, height = len(border), len(small)

    def closed(reach: int) -> npt.NDArray[np.int64]:
        around = np.arange(width)[:, np.newaxis] + np.arange(-reach, reach + 1)
        out: npt.NDArray[np.int64] = border[around % width].max(axis=1)[around % width].min(axis=1)
        return out

    # within 30 degrees of the zenith a small cloud spans many columns
    reach, wide = max(1, round(GLARE_WIDTH * width / 2)), max(1, width // 4)
    lowered = np.where(border < height / 6, closed(wide), closed(reach))
    grey = cv2.cvtColor(small, cv2.COLOR_RGB2GRAY)
    nearby = cv2.dilate(np.pad(grey, ((0, 0), (2, 2)), mode="wrap"), np.ones((5, 5), np.uint8))[:, 2:-2].astype(
        np.int64
    )
    columns = np.arange(width)
    before = nearby[np.maximum(border - 4, 0), columns]
    after = nearby[np.minimum(border + 1, height - 1), columns]
    return np.where(after > before + GLARE_STEP, lowered, border)
