"""asinh and sinh of whole rows, in float32 and in a form that the compiler can vectorise.

The range is reduced with the bits of the number (Cody and Waite 1980, "Software Manual for the Elementary Functions"); what
is left is ln m = 2 artanh((m − 1)/(m + 1)) for m within half an octave of 1, and 2^r for |r| ≤ 1/2, as polynomials that were
fitted by least squares at Chebyshev points to below one part in 10⁷.
"""

import numpy as np
import numpy.typing as npt
from numba import njit

Row = npt.NDArray[np.float32]

_HALF, _ONE = np.float32(0.5), np.float32(1.0)
_LN2, _LOG2E = np.float32(np.log(2.0)), np.float32(1.0 / np.log(2.0))
_L1, _L3, _L5, _L7 = np.float32(2.0), np.float32(0.66666816), np.float32(0.39974768), np.float32(0.2992643)
_E0, _E1, _E2 = np.float32(1.0), np.float32(0.6931472057), np.float32(0.240226466)
_E3, _E4, _E5 = np.float32(0.0555032888), np.float32(0.00961851981), np.float32(0.00133999076)
_E6 = np.float32(0.000153376190)

# The bits of 1, of its fraction, and of √½, from where an octave is cut.
_ONE_BITS, _FRACTION, _CUT = np.int32(0x3F800000), np.int32(23), np.int32(0x3F3504F3)


@njit(cache=True, error_model="numpy")
def to_log(x: Row, factor: float, out: Row) -> None:  # pragma: no cover - compiled
    """Write asinh(x · factor)."""
    for i in range(len(x)):
        v = abs(x[i]) * factor
        a = v + np.sqrt(v * v + _ONE)
        bits = np.float32(a).view(np.int32)
        octave = (bits - _CUT) >> _FRACTION
        m = np.int32(bits - (octave << _FRACTION)).view(np.float32)
        s = (m - _ONE) / (m + _ONE)
        q = s * s
        t = np.float32(octave) * _LN2 + s * (_L1 + q * (_L3 + q * (_L5 + q * _L7)))
        out[i] = t if x[i] >= 0 else -t


@njit(cache=True, error_model="numpy")
def to_light(t: Row, unit: float) -> None:  # pragma: no cover - compiled
    """Replace t by unit · sinh(t)."""
    for i in range(len(t)):
        octaves = abs(t[i]) * _LOG2E
        whole = np.int32(octaves + _HALF)
        r = octaves - np.float32(whole)
        p = _E0 + r * (_E1 + r * (_E2 + r * (_E3 + r * (_E4 + r * (_E5 + r * _E6)))))
        e = p * np.int32(_ONE_BITS + (whole << _FRACTION)).view(np.float32)
        x = _HALF * (e - _ONE / e) * unit
        t[i] = x if t[i] >= 0 else -x
