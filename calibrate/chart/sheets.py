"""A lat-long map cut into three sheets in which a chart's patches are patches: a band around the horizon and two caps.

Zones of one colour are looked for where the map is stretched least: within 65° of the horizon in the map itself, continued
across its seam, and within 75° of each pole in a stereographic projection, which keeps angles. So any chart up to 50° wide lies
whole in one of them. Straight lines are bent there; a lattice follows them step by step, and what it found is laid into
a perspective view before its box is drawn.
"""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

Points = npt.NDArray[np.float64]

_BAND: Final = np.radians(65.0)
_CAP: Final = np.radians(75.0)
# What is repeated beyond the seam: a chart may stand on it.
_REPEATED: Final = np.radians(60.0)


@dataclass(frozen=True, slots=True)
class Sheet:
    """A part of a map [H, W, 3]. `pole` is 0 for the band, 1 for the upper cap, −1 for the lower one; `px_per_radian` is the
    map's, and `first` the row (band) or the pole's pixel (cap) from which angles are counted.
    """

    pixels: npt.NDArray[np.float32]
    pole: int
    px_per_radian: float
    first: float

    def directions(self, points: Points) -> Points:
        """Return the unit directions [N, 3] that the sheet's pixels [N, 2] look at."""
        if self.pole == 0:
            phi = (points[:, 0] + 0.5) / self.px_per_radian - np.pi
            theta = (points[:, 1] + self.first + 0.5) / self.px_per_radian
        else:
            x, y = (points - self.first).T
            phi = np.arctan2(y, x)
            theta = 2 * np.arctan(np.hypot(x, y) / (2 * self.px_per_radian))
            theta = theta if self.pole > 0 else np.pi - theta
        return np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi)], axis=-1)


def sheets(environment: npt.NDArray[np.float32]) -> tuple[Sheet, ...]:
    """Return band, upper and lower cap of a lat-long map [H, W, 3] without NaN."""
    height, width = environment.shape[:2]
    px_per_radian = width / (2 * np.pi)
    row = round(height / 2 - _BAND * height / np.pi)
    repeated = round(_REPEATED * px_per_radian)
    band = np.concatenate([environment[row : height - row], environment[row : height - row, :repeated]], axis=1)
    radius = int(2 * px_per_radian * np.tan(_CAP / 2)) + 1
    y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1].astype(np.float32)
    theta = 2 * np.arctan(np.hypot(x, y) / np.float32(2 * px_per_radian))
    # One column more on either side: the cap goes round.
    around = np.concatenate([environment[:, -1:], environment, environment[:, :1]], axis=1)
    column = (np.arctan2(y, x) + np.float32(np.pi)) * np.float32(px_per_radian) + np.float32(0.5)
    caps = []
    for pole in (1, -1):
        from_top = theta if pole > 0 else np.float32(np.pi) - theta
        line = np.clip(from_top * np.float32(height / np.pi) - np.float32(0.5), 0, height - 1)
        cap = np.asarray(cv2.remap(around, column, line, cv2.INTER_LINEAR), dtype=np.float32)
        caps.append(Sheet(cap, pole, px_per_radian, float(radius)))
    return (Sheet(band, 0, px_per_radian, float(row)), *caps)
