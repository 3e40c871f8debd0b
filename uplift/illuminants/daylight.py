"""Daylight: CIE D50, D55, D65, D75 and blends of them, Judd's D series above.

Between 5000 and 7500 K the published tables are interpolated, as Tódová and Wilkie (EGSR 2024) do, so that D65 is D65
to the last digit; above, the D series of Judd, MacAdam and Wyszecki (1964; CIE 015:2018, equations 4.7 to 4.11) on its
basis S0, S1, S2, up to 25 000 K, where its definition ends.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import numpy.typing as npt

from uplift.illuminants.nodes import Node, cct_duv_of, check_range, interpolated, nodes_of, solved
from uplift.spectrum import Observer, illuminant, normalised

Floats = npt.NDArray[np.float64]

RANGE_K = (5000.0, 25_000.0)


def daylight(cct: float, observer: Observer) -> Floats:
    """Return the emission [N], Y = 1, of daylight whose CCT is `cct` kelvin, 5000–25 000.

    At the CCT that `cct_duv` gives for CIE D65 (6503 K) this is the table of D65 itself. Raises UpliftError outside
    the range.
    """
    check_range("daylight", cct, *RANGE_K, "Below, a low sun is meant: type sunset. Above, give a measured spectrum.")
    nodes = _tables(observer)
    if cct <= nodes[-1].cct:
        return interpolated(nodes, cct, observer)
    return d_series_of_cct(cct, observer)


@cache
def _tables(observer: Observer) -> tuple[Node, ...]:
    # D50 has 5001 K on the international scale of 1968 and later; the node below serves the last kelvin
    spectra = [("D series, 4900 K", normalised(d_series(4900.0, observer), observer))]
    spectra += [(name, illuminant(name, observer)) for name in ("D50", "D55", "D65", "D75")]
    return nodes_of(spectra, observer)


def d_series_of_cct(cct: float, observer: Observer) -> Floats:
    """Return the D series' emission [N], Y = 1, whose CCT on the observer's grid is `cct`, 4000–25 000 K.

    The series' own parameter differs from it by a few kelvin, and by the grid.
    """
    nominal = solved(lambda t: cct_duv_of(d_series(t, observer), observer)[0] - cct, cct * 0.98, cct * 1.02)
    return normalised(d_series(nominal, observer), observer)


def d_series(nominal_cct: float, observer: Observer) -> Floats:
    """Return the relative spectrum [N] of Judd's D series at its nominal CCT, 100 at 560 nm.

    Zero where the basis is not defined (below 300 and above 830 nm). CIE 015:2018, equations 4.7–4.11; below 7000 K
    and above, two cubics give x, and the parabola of the daylight locus gives y.
    """
    inverse = 1000.0 / nominal_cct
    if nominal_cct <= 7000.0:
        x = 0.244063 + inverse * (0.09911 + inverse * (2.9678 - inverse * 4.6070))
    else:
        x = 0.237040 + inverse * (0.24748 + inverse * (1.9018 - inverse * 2.0064))
    y = -3.000 * x**2 + 2.870 * x - 0.275
    m = 0.0241 + 0.2562 * x - 0.7341 * y
    m1 = (-1.3515 - 1.7703 * x + 5.9114 * y) / m
    m2 = (0.0300 - 31.4424 * x + 30.0717 * y) / m
    mean, yellow_blue, pink_green = _basis(observer)
    return np.maximum(mean + m1 * yellow_blue + m2 * pink_green, 0.0)


@cache
def _basis(observer: Observer) -> tuple[Floats, Floats, Floats]:
    from colour.colorimetry import SDS_BASIS_FUNCTIONS_CIE_ILLUMINANT_D_SERIES

    basis = SDS_BASIS_FUNCTIONS_CIE_ILLUMINANT_D_SERIES
    mean, yellow_blue, pink_green = (
        np.interp(observer.wavelengths_nm, basis[name].wavelengths, basis[name].values, left=0.0, right=0.0)
        for name in ("S0", "S1", "S2")
    )
    return mean, yellow_blue, pink_green
