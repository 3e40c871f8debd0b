"""Cameras without a lens: which pixel sees which direction. The lat-long convention is that of `envcal`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

Float64 = npt.NDArray[np.float64]


class Projection(Protocol):
    """A way to map directions to pixels; the centre of pixel (x, y) is at (x, y)."""

    width: int
    height: int

    def directions(self, sub: int) -> Float64:
        """Return unit directions, shape (height · width, sub², 3), of the sub-rays of every pixel."""

    def pixels(self, directions: Float64) -> Float64:
        """Return (x, y), shape (..., 2), of directions of shape (..., 3)."""


@dataclass(frozen=True, slots=True)
class LatLong:
    """The whole sphere on a map twice as wide as high; the centre looks along −Z, the top row at +Y."""

    width: int
    height: int = 0

    def __post_init__(self) -> None:
        if self.height == 0:
            object.__setattr__(self, "height", self.width // 2)

    def directions(self, sub: int) -> Float64:
        """Return unit directions, shape (height · width, sub², 3)."""
        x, y = _sub_pixels(self.width, self.height, sub)
        longitude = 2.0 * np.pi * ((x + 0.5) / self.width - 0.5)
        polar = np.pi * (y + 0.5) / self.height
        sine = np.sin(polar)
        return np.stack([sine * np.sin(longitude), np.cos(polar), -sine * np.cos(longitude)], axis=-1)

    def pixels(self, directions: Float64) -> Float64:
        """Return (x, y), shape (..., 2), of directions of shape (..., 3)."""
        d = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
        u = np.arctan2(d[..., 0], -d[..., 2]) / (2.0 * np.pi) + 0.5
        v = np.arccos(np.clip(d[..., 1], -1.0, 1.0)) / np.pi
        return np.stack([u * self.width - 0.5, v * self.height - 0.5], axis=-1)


@dataclass(frozen=True, slots=True)
class Pinhole:
    """A flat perspective view towards (azimuth, elevation); `fov_deg` is the angle across the width."""

    width: int
    height: int
    fov_deg: float = 60.0
    azimuth_deg: float = 0.0
    elevation_deg: float = 0.0

    def _frame(self) -> tuple[Float64, float]:
        axis = direction(self.azimuth_deg, self.elevation_deg)
        return facing(axis), 0.5 * self.width / np.tan(np.radians(self.fov_deg) / 2.0)

    def directions(self, sub: int) -> Float64:
        """Return unit directions, shape (height · width, sub², 3)."""
        frame, focal = self._frame()
        x, y = _sub_pixels(self.width, self.height, sub)
        a = (x - 0.5 * (self.width - 1))[..., None] / focal
        b = (0.5 * (self.height - 1) - y)[..., None] / focal
        rays: Float64 = a * frame[0] + b * frame[1] - frame[2]
        return rays / np.sqrt((rays * rays).sum(axis=-1, keepdims=True))

    def pixels(self, directions: Float64) -> Float64:
        """Return (x, y), shape (..., 2), of directions of shape (..., 3) in front of the camera."""
        frame, focal = self._frame()
        local = np.einsum("...i,ji->...j", directions, frame)
        x = 0.5 * (self.width - 1) + focal * local[..., 0] / -local[..., 2]
        y = 0.5 * (self.height - 1) - focal * local[..., 1] / -local[..., 2]
        return np.stack([x, y], axis=-1)


def _sub_pixels(width: int, height: int, sub: int) -> tuple[Float64, Float64]:
    """Return x and y, shape (height · width, sub²), of a grid of sub × sub places in every pixel."""
    offsets = (np.arange(sub) + 0.5) / sub - 0.5
    y, x, j, i = np.meshgrid(
        np.arange(height, dtype=np.float64), np.arange(width, dtype=np.float64), offsets, offsets, indexing="ij"
    )
    return (x + i).reshape(-1, sub * sub), (y + j).reshape(-1, sub * sub)


def direction(azimuth_deg: float, elevation_deg: float) -> Float64:
    """Return the unit vector at an azimuth (0 = −Z, 90 = +X) and an elevation."""
    a, e = np.radians(azimuth_deg), np.radians(elevation_deg)
    return np.array([np.cos(e) * np.sin(a), np.sin(e), -np.cos(e) * np.cos(a)])


def facing(axis: Float64) -> Float64:
    """Return the rows right, up, forward of a plate that faces a viewer who looks along `axis`."""
    right = np.cross(axis, [0.0, 1.0, 0.0])
    right = right / np.linalg.norm(right)
    return np.stack([right, np.cross(right, axis), -axis])
