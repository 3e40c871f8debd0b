"""The 24 reflectances of a ColorChecker, as measured, for scenes and relight figures."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

#: The set of colour-science that is meant: means over 30 charts, 380 to 730 nm.
SOURCE = "BabelColor Average"


def colour_checker(wavelengths_nm: npt.NDArray[np.float64]) -> dict[str, npt.NDArray[np.float64]]:
    """Return name → reflectance [N] of the 24 patches, row by row from dark skin, at `wavelengths_nm` [N].

    Linear between the measured wavelengths; beyond them, where the eye sees next to nothing, the last value holds.
    """
    from colour.characterisation import SDS_COLOURCHECKERS

    return {
        name: np.interp(wavelengths_nm, measured.wavelengths, measured.values)
        for name, measured in SDS_COLOURCHECKERS[SOURCE].items()
    }
