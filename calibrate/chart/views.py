"""Perspective (gnomonic) views of a lat-long map, in which a flat chart is a flat chart again.

Lat-long: pixel (x, y) has u = (x + ½)/W, v = (y + ½)/H, longitude φ = 2π(u − ½), angle from the zenith θ = πv, and the
direction (sin θ sin φ, cos θ, −sin θ cos φ).
"""

from dataclasses import dataclass
from typing import TypeVar

import cv2
import numpy as np
import numpy.typing as npt

Points = npt.NDArray[np.float64]
_Real = TypeVar("_Real", np.float32, np.float64)


@dataclass(frozen=True, slots=True)
class View:
    """A square perspective view: `axes` [3, 3] holds its right, down and forward directions as rows, `side` its pixels,
    `focal_px` the distance of its image plane, `map_size` (H, W) of the map it looks at.
    """

    axes: Points
    side: int
    focal_px: float
    map_size: tuple[int, int]

    def map_points(self, points: npt.NDArray[_Real]) -> npt.NDArray[_Real]:
        """Return the map pixels [..., 2] of view pixels [..., 2]; x is continuous around the view's centre."""
        centred = (points - (self.side - 1) / 2) / self.focal_px
        axes = self.axes.astype(points.dtype)
        directions = centred[..., :1] * axes[0] + centred[..., 1:] * axes[1] + axes[2]
        height, width = self.map_size
        forward = float(np.arctan2(self.axes[2, 0], -self.axes[2, 2]))
        phi = np.arctan2(directions[..., 0], -directions[..., 2]) - forward
        phi = forward + (phi + np.pi) % (2 * np.pi) - np.pi
        theta = np.arctan2(np.hypot(directions[..., 0], directions[..., 2]), directions[..., 1])
        return np.stack([(phi / (2 * np.pi) + 0.5) * width - 0.5, theta / np.pi * height - 0.5], axis=-1)

    def directions(self, points: Points) -> Points:
        """Return the unit directions [..., 3] of view pixels [..., 2]."""
        centred = (points - (self.side - 1) / 2) / self.focal_px
        rays = centred @ self.axes[:2] + self.axes[2]
        return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True))

    def before(self, points: Points) -> bool:
        """Whether view pixels [..., 2] are at less than 60° from the middle of the view, where a flat chart is seen as one."""
        return bool(
            np.hypot(*np.moveaxis(points - (self.side - 1) / 2, -1, 0)).max() < self.focal_px * np.tan(np.pi / 3)
        )

    def points(self, directions: Points) -> Points:
        """Return the view pixels [..., 2] of directions [..., 3] before it, the inverse of `directions`."""
        local = directions @ self.axes.T
        return np.asarray(local[..., :2] / local[..., 2:] * self.focal_px + (self.side - 1) / 2)

    def render(self, environment: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Return what the view shows of a lat-long map [H, W, 3]: [side, side, 3], bilinear; NaN where it touches NaN."""
        y, x = np.mgrid[: self.side, : self.side]
        points = self.map_points(np.stack([x, y], axis=-1).astype(np.float32))
        width = self.map_size[1]
        # Only the columns in view, with their neighbours across the seam: remap's sides are limited to 32767.
        first, last = int(np.floor(points[..., 0].min())) - 1, int(np.ceil(points[..., 0].max())) + 2
        strip = np.ascontiguousarray(environment[:, np.arange(first, last) % width])
        return np.asarray(
            cv2.remap(strip, points[..., 0] - first, points[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE),
            dtype=np.float32,
        )


def directions_on_map(points: Points, map_size: tuple[int, int]) -> Points:
    """Return the unit directions [..., 3] of pixels [..., 2] of a lat-long map of `map_size` (H, W)."""
    phi = 2 * np.pi * ((points[..., 0] + 0.5) / map_size[1] - 0.5)
    theta = np.pi * (points[..., 1] + 0.5) / map_size[0]
    return np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi)], axis=-1)


def view_at(yaw: float, pitch: float, *, field_of_view: float, side: int, map_size: tuple[int, int]) -> View:
    """Return the view in the direction `yaw` (to the right of −Z), `pitch` (above the horizon); all angles in radians."""
    forward = np.array([np.cos(pitch) * np.sin(yaw), np.sin(pitch), -np.cos(pitch) * np.cos(yaw)])
    right = np.array([np.cos(yaw), 0.0, np.sin(yaw)])
    down = np.cross(forward, right)
    focal_px = side / 2 / np.tan(field_of_view / 2)
    return View(np.stack([right, down, forward]), side, float(focal_px), map_size)
