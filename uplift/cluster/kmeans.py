"""K-means of colours by the angle between them, on a histogram."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Image = npt.NDArray[np.float32]
Labels = npt.NDArray[np.int64]

BINS = 256  # of each angle; bins keep their mean, so this bounds what is told apart, not the accuracy


def angles(rgb: Floats) -> Floats:
    """The paper's features [..., 2]: polar angle from the blue axis, and azimuth from red to green."""
    radius = np.sqrt((rgb**2).sum(axis=-1))
    with np.errstate(divide="ignore", invalid="ignore"):
        theta = np.arccos(np.clip(rgb[..., 2] / radius, -1.0, 1.0))
    return np.stack([np.where(radius > 0, theta, 0.0), np.arctan2(rgb[..., 1], rgb[..., 0])], axis=-1)


def directions(rgb: Floats) -> Floats:
    """Unit vectors [..., 3]: chords between them grow with the angle between colours, without poles."""
    radius = np.sqrt((rgb**2).sum(axis=-1, keepdims=True))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(radius > 0, rgb / radius, 0.0)


def histogram(features: Floats, rgb: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """Mean feature [B, F] and weight [B] of the occupied bins of both angles."""
    cells = np.clip((angles(rgb) * (BINS / (np.pi / 2))).astype(np.int64), 0, BINS - 1)
    bins = cells[:, 0] * BINS + cells[:, 1]
    total = np.bincount(bins, weight, BINS * BINS)
    used = np.flatnonzero(total > 0)
    sums = [
        np.bincount(bins, weight * features[:, i], BINS * BINS)[used] / total[used] for i in range(features.shape[1])
    ]
    return np.stack(sums, axis=1), total[used] / total[used].sum()


def squared(points: Floats, centres: Floats) -> Floats:
    """Squared distances [P, k]."""
    out: Floats = ((points[:, np.newaxis] - centres) ** 2).sum(axis=2)
    return out


def kmeans_up_to(points: Floats, weight: Floats, k_max: int) -> list[Floats]:
    """Centres [k, F] for k = 1 … k_max, each grown from the last (fast global k-means, Likas et al. 2003).

    The new centre starts at the heaviest of up to 512 bins that lessens the variance most, so nothing is random.
    """
    centres = (weight @ points / weight.sum())[np.newaxis]
    steps = [centres]
    heavy = np.argsort(-weight, kind="stable")[:512]
    between = squared(points, points[heavy])
    for _ in range(1, min(k_max, len(points))):
        nearest = squared(points, centres).min(axis=1)
        gain = weight @ np.maximum(nearest[:, np.newaxis] - between, 0.0)
        if gain.max() <= 1e-12:
            break  # every bin stands on a centre: one more would be empty
        centres = _lloyd(points, weight, np.vstack([centres, points[heavy[np.argmax(gain)]]]))
        steps.append(centres)
    return steps


def _lloyd(points: Floats, weight: Floats, centres: Floats) -> Floats:
    for _ in range(100):
        label = np.argmin(squared(points, centres), axis=1)
        mass = np.bincount(label, weight, len(centres))
        sums = [np.bincount(label, weight * points[:, i], len(centres)) for i in range(points.shape[1])]
        moved = np.where(
            mass[:, np.newaxis] > 0, np.stack(sums, axis=1) / np.maximum(mass, 1e-300)[:, np.newaxis], centres
        )
        if np.abs(moved - centres).max() < 1e-9:
            break
        centres = moved
    return centres


def labelled(image: Image, centres: Floats) -> npt.NDArray[np.uint32]:
    """Return the nearest centre [k, 2] of the paper's angles for every pixel [H, W]; 0 where one is black or not finite."""
    labels = np.zeros(image.shape[:2], np.uint32)
    if len(centres) == 1:
        return labels
    for start in range(0, len(image), 64):  # in strips of rows
        strip = image[start : start + 64]
        fine: npt.NDArray[np.bool_] = np.asarray(np.isfinite(strip).all(axis=2))
        rgb = np.where(fine[..., np.newaxis], np.maximum(strip, 0.0), 0.0).astype(np.float64)
        nearest = np.argmin(squared(angles(rgb).reshape(-1, 2), centres), axis=1).reshape(fine.shape)
        labels[start : start + 64] = np.where(fine & (rgb.sum(axis=2) > 0), nearest, 0)
    return labels
