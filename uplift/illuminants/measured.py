"""A measured spectrum, checked and brought onto the observer's grid."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import numpy.typing as npt

from uplift import UpliftError
from uplift.spectrum import Observer, normalised

Floats = npt.NDArray[np.float64]


class Distribution(Protocol):
    """What a spectral distribution has."""

    @property
    def wavelengths(self) -> npt.NDArray[np.float64]: ...
    @property
    def values(self) -> npt.NDArray[np.float64]: ...


MUST_COVER_NM = (400.0, 700.0)  # outside, the observer's ȳ is below 0.5 % of its peak
MAX_GAP_NM = 20.0
NOISE = 0.01  # of the peak: how far below zero an instrument's noise may reach


def measured_emission(
    wavelengths_nm: npt.ArrayLike, power: npt.ArrayLike, observer: Observer, *, name: str = "measured spectrum"
) -> Floats:
    """Return a measured spectrum on the observer's grid, Y = 1.

    Finer samples than the grid's are averaged over each of its steps, so that no narrow line is lost between two
    wavelengths; coarser or equal ones are interpolated linearly. The end values are held beyond the ends (CIE 015:2018,
    section 7.2.3). Negative values down to 1 % of the peak are noise and count as 0.

    Parameters
    ----------
    wavelengths_nm
        Shape [M], M ≥ 2, nm, in any order, all different.
    power
        Shape [M]. Radiometric, per wavelength, in any unit.
    name
        What messages call it.

    Raises
    ------
    UpliftError
        If shapes differ, a value is not finite or clearly negative, all are zero, a wavelength occurs twice, the range
        does not cover 400–700 nm or has a gap of more than 20 nm there.
    """
    where = np.asarray(wavelengths_nm, np.float64)
    values = np.asarray(power, np.float64)
    if where.ndim != 1 or where.shape != values.shape or len(where) < 2:
        raise UpliftError(
            f"{name}: {where.shape} wavelengths and {values.shape} values; expected two columns of equal length, at "
            "least two rows"
        )
    if not (np.isfinite(where).all() and np.isfinite(values).all()):
        row = int(np.flatnonzero(~(np.isfinite(where) & np.isfinite(values)))[0])
        raise UpliftError(f"{name}: row {row} is not a number; remove it, or measure again")
    order = np.argsort(where, kind="stable")
    where, values = where[order], values[order]
    if (np.diff(where) <= 0).any():
        twice = where[int(np.argmin(np.diff(where)))]
        raise UpliftError(f"{name}: {twice:g} nm occurs twice; keep one value for each wavelength")
    if values.max() <= 0:
        raise UpliftError(f"{name}: no value above zero; expected a spectrum of light")
    if values.min() < -NOISE * values.max():
        at = where[int(np.argmin(values))]
        raise UpliftError(
            f"{name}: {values.min():g} at {at:g} nm is negative beyond noise (1 % of the peak); power is ≥ 0. Subtract "
            "the right dark spectrum"
        )
    low, high = MUST_COVER_NM
    if where[0] > low or where[-1] < high:
        raise UpliftError(
            f"{name}: covers {where[0]:g}–{where[-1]:g} nm; expected at least {low:g}–{high:g} nm. Are the wavelengths in "
            "nanometres?"
        )
    inside = where[(where >= low - MAX_GAP_NM) & (where <= high + MAX_GAP_NM)]
    if np.diff(inside).max(initial=0.0) > MAX_GAP_NM:
        raise UpliftError(
            f"{name}: a gap of {np.diff(inside).max():g} nm; expected samples at most {MAX_GAP_NM:g} nm apart"
        )
    values = np.maximum(values, 0.0)
    return normalised(resampled(where, values, observer), observer)


def emission_of_distribution(distribution: Distribution, observer: Observer) -> Floats:
    """Return a spectral distribution of colour-science on the observer's grid, Y = 1.

    Any object with `wavelengths` in nm, `values` and a `name` will do. Raises UpliftError as `measured_emission` does.
    """
    return measured_emission(
        distribution.wavelengths, distribution.values, observer, name=str(getattr(distribution, "name", "spectrum"))
    )


def resampled(wavelengths_nm: Floats, values: Floats, observer: Observer) -> Floats:
    """Return `values` at ascending wavelengths on the observer's grid: averaged if finer than it, else interpolated."""
    grid = observer.wavelengths_nm
    if np.median(np.diff(wavelengths_nm)) > 0.99 * observer.step_nm:
        return np.interp(grid, wavelengths_nm, values)
    edges = np.append(grid, grid[-1] + observer.step_nm) - observer.step_nm / 2.0
    knots = np.union1d(wavelengths_nm, edges)
    curve = np.interp(knots, wavelengths_nm, values)
    area = np.concatenate([[0.0], np.cumsum(np.diff(knots) * (curve[1:] + curve[:-1]) / 2.0)])
    return np.diff(area[np.searchsorted(knots, edges)]) / observer.step_nm
