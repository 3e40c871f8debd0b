"""What a lamp reads: the mean over its interior, its standard error, and doubts about it."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError
from calibrate.chart.patches import trimmed_mean
from calibrate.lamp.curve import uv_from_xyz

Points = npt.NDArray[np.float64]
Image = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

MOST_CLIPPED: Final = 0.3
# Of the light on the chart, what an unlit module may reflect: opal covers about half of it, white circuit boards up to this.
MOST_REFLECTED: Final = 0.8
_FEW_PIXELS: Final = 60
_FEWEST_PIXELS: Final = 4
# Scatter of u'v' inside a lamp, of one channel's noise or so; an evenly lit module stays below 0.005.
_UNEVEN: Final = 0.01
# Relative standard error of the reading in its worst channel.
_NOISY: Final = 0.01
_TOO_NOISY: Final = 0.05


@dataclass(frozen=True, slots=True)
class Lamp:
    """A lamp as it reads.

    `rgb` [3] is the mean working RGB over the interior, `noise` [3] its standard error; `polygon` [N, 2] outlines it in pixels
    (x, y), integer = centre (in a lat-long map x is continuous across the seam). `pixels` were used, `clipped` were NaN or
    marked. `score` is the probability that it is the module (NaN if it was named), `runner_up` that of the next
    candidate (0 if none). `unevenness` is the scatter of u'v' inside.
    """

    rgb: npt.NDArray[np.float64]
    noise: npt.NDArray[np.float64]
    polygon: Points
    pixels: int
    clipped: int
    score: float
    runner_up: float
    unevenness: float
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Region:
    """An area of an image: its outline, the pixels `inside` a box whose first pixel is `origin` (x, y), and the share of those
    that is clipped.
    """

    polygon: Points
    inside: Mask
    origin: tuple[int, int]
    clipped: float


def _doubts_of_noise(rgb: npt.NDArray[np.float64], noise: npt.NDArray[np.float64], place: str) -> tuple[str, ...]:
    """Return a warning if the reading is noisy, as a dim lamp's is; refuse it where it is hopeless."""
    worst = float((noise / np.maximum(np.abs(rgb), 1e-30)).max())
    told = (
        f"{place} is known to {worst:.1%} in its worst channel; expected {_NOISY:.0%} or better. "
        "Add longer exposures to the bracket, or photograph the module larger or brighter."
    )
    if worst > _TOO_NOISY:
        raise CalibrateError(told)
    return (told,) if worst > _NOISY else ()


def read_region(
    image: Image,
    region: Region,
    *,
    xyz_from_rgb: npt.NDArray[np.float64],
    clipped: Mask | None,
    latlong: bool,
) -> Lamp:
    """Return mean, standard error and doubts of a region; refuse it where it is clipped, tiny or dark."""
    rows, columns = np.nonzero(region.inside)
    x, y = columns + region.origin[0], rows + region.origin[1]
    if latlong:
        x = x % image.shape[1]
    samples = image[y, x].astype(np.float64)
    valid = np.isfinite(samples).all(axis=1)
    if clipped is not None:
        valid &= ~clipped[y, x]
    lost = int((~valid).sum())
    place = f"balance.lamp: the lamp at ({region.polygon[:, 0].mean():.0f}, {region.polygon[:, 1].mean():.0f})"
    if lost > MOST_CLIPPED * len(samples):
        raise CalibrateError(
            f"{place} is clipped in {lost} of {len(samples)} pixels; at most {MOST_CLIPPED:.0%} may be. Add a shorter "
            "exposure to the bracket, or set `balance.lamp` to a rectangle that leaves the clipped part out."
        )
    if valid.sum() < _FEWEST_PIXELS:
        raise CalibrateError(
            f"{place} covers {int(valid.sum())} usable pixels; at least {_FEWEST_PIXELS} are needed, 60 are good. Enlarge the rectangle in "
            "`balance.lamp`, or photograph the module larger."
        )
    statistics = [trimmed_mean(samples[valid, channel]) for channel in range(3)]
    rgb = np.array([mean for mean, _, _ in statistics])
    noise = np.array([deviation / np.sqrt(count) for _, deviation, count in statistics])
    xyz = samples[valid] @ np.asarray(xyz_from_rgb, dtype=np.float64).T
    if (rgb @ np.asarray(xyz_from_rgb, dtype=np.float64).T <= 0).any():
        raise CalibrateError(
            f"{place} reads {rgb.round(5).tolist()}, which is no light; expected positive XYZ. Point `balance.lamp` at the "
            "module."
        )
    # Noise makes single pixels differ; what counts is whether one part of the lamp differs from another.
    unevenness = float(uv_from_xyz(xyz).std(axis=0).max())
    warnings = _doubts_of_noise(rgb, noise, place)
    if valid.sum() < _FEW_PIXELS:
        warnings += (f"{place} has only {int(valid.sum())} pixels inside. Photograph the module larger.",)
    if lost:
        warnings += (f"{place} has {lost} clipped pixels, left out. Add a shorter exposure to the bracket.",)
    if unevenness > _UNEVEN:
        warnings += (
            f"{place} is not of one colour: u'v' scatters by {unevenness:.3f}, more than {_UNEVEN}. Check that the area "
            "lies inside the module, and that the module is diffused.",
        )
    return Lamp(
        rgb=rgb,
        noise=noise,
        polygon=region.polygon,
        pixels=int(valid.sum()),
        clipped=lost,
        score=float("nan"),
        runner_up=0.0,
        unevenness=unevenness,
        warnings=warnings,
    )
