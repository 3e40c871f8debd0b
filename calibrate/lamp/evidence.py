"""The odds that something in the picture is the lamp, against there being none.

Each term is the logarithm of how often lamps look so over how often other things do: windows, screens, other lamps, glints,
paper. They are added with weights near 1 (less where terms tell the same twice) as in logistic regression. The forms of the terms
are assumed; weights and offset were fitted to 346 synthetic scenes with and without a lamp, and are rounded.
"""

from typing import Final

import numpy as np

from calibrate.difference import D65_XYZ
from calibrate.lamp.candidate import Candidate
from calibrate.lamp.curve import adapted_d65_curve, uv_from_xyz
from calibrate.lamp.expected import ExpectedColour, ExpectedForm, Floats, student, white_rgb
from calibrate.lamp.reading import MOST_REFLECTED

# Weights of the terms; those of place and size are 1 where the settings state them.
_COLOUR: Final = 0.8
_PLACE: Final = 0.65
_SIZE: Final = 0.8
_OFFSET: Final = -1.3

# The rim of a clipped region is mixed with its surround, and demosaicing errs there.
_RIM_COVARIANCE: Final = 0.15**2 * np.eye(2)
# Daylight of 5000–10000 K in windows and on screens, about D65, in (log R/G, log B/G) of most cameras.
_ALONG: Final = np.array([[-0.55, -0.83], [0.83, -0.55]])
_DAYLIGHT: Final = _ALONG @ np.diag([0.22**2, 0.07**2]) @ _ALONG.T
_SCENES_LIGHT: Final = 0.06**2 * np.eye(2)
_ANY_LAMP: Final = 0.6**2 * np.eye(2)
# u'v' about the curve of D65 from any light: lamps that are no black bodies, chart matrices and modules each add about 0.01.
_CURVE_SIGMA: Final = 0.015
_CURVE_SIGMA_OF_RIM: Final = 0.04
# In standard deviations; farther off no light makes D65 look so.
_OFF_CURVE: Final = 4.0
_IMPOSSIBLE: Final = -20.0
_WHITE_SIGMA: Final = 0.012
# Reflected light of the scene is tried in so many steps.
_SHARES: Final = 8

# Scatter of u'v' and of log luminance between the parts of a lamp: modules stay below, views through windows do not.
_TINTS: Final = 0.003
_LEVELS: Final = 0.25
# Of the rectangle or ellipse, what noise and blur leave of a lamp.
_FILL: Final = 0.9

# Short and long side in widths of the chart: strips, modules, and all else, with the scatter of their logarithms.
_STRIPS: Final = (np.log([0.05, 0.7]), np.diag([0.35**2, 0.45**2]))
_MODULES: Final = (np.log([0.19, 0.25]), np.diag([0.45**2, 0.45**2]))
_OTHERS: Final = (np.log([0.25, 0.5]), np.eye(2))
# A lamp of stated size: nearer or farther than the chart by 15 %, tilted and blurred at its edges.
_STATED: Final = 0.15**2 * np.ones((2, 2)) + 0.12**2 * np.eye(2)
_NEAR: Final = 0.6


def log_odds(one: Candidate, xyz_from_rgb: Floats, expected: ExpectedColour | None, form: ExpectedForm) -> float:
    """Return the logarithm of the odds that a candidate is the lamp, against there being none in view."""
    colour = _curve_colour(one) if expected is None else _camera_colour(one, xyz_from_rgb, expected)
    pixels = float(one.region.inside.sum())
    return (
        _OFFSET
        + _COLOUR * colour
        + (_PLACE if form.within is None else 1.0) * _place(one, form)
        + (_SIZE if form.size is None else 1.0) * _size(one, form)
        + 0.9 * _shining(one)
        - 0.75 * float(np.log1p((one.tints / _TINTS) ** 2))
        - 0.3 * float(np.log1p((one.levels / _LEVELS) ** 2))
        + 2.8 * one.steady
        - 2.2 * float(np.log1p(one.alike))
        - 3.0 * one.border
        - 7.0 * max(_FILL - one.fill, 0.0)
        + 0.3 * float(np.log(pixels / (pixels + 40.0)))
    )


def _camera_colour(one: Candidate, xyz_from_rgb: Floats, expected: ExpectedColour) -> float:
    """Density of a lamp at this colour in camera RGB, whatever it reflects, over that of other things."""
    white = white_rgb(xyz_from_rgb)
    own = one.rgb - _reflectable(one)[:, None] * white
    covariance = expected.covariance() + (_RIM_COVARIANCE if one.rim else 0.0)
    there = expected.ratios(one.rgb)
    other = (
        0.35 * student(there, _DAYLIGHT)
        + 0.35 * student(there - expected.ratios(white), _SCENES_LIGHT)
        + 0.3 * student(there, _ANY_LAMP)
    )
    return float(np.log(student(expected.ratios(own), covariance).mean() / other))


def _curve_colour(one: Candidate) -> float:
    """The same where the camera is not known: a lamp lies on the curve of D65 seen from some light."""
    own = one.xyz - _reflectable(one)[:, None] * D65_XYZ
    distance = np.hypot(*np.moveaxis(uv_from_xyz(own)[:, None] - adapted_d65_curve(), -1, 0)).min()
    away = distance / (_CURVE_SIGMA_OF_RIM if one.rim else _CURVE_SIGMA)
    if away > _OFF_CURVE:
        return _IMPOSSIBLE
    lamp = (1 + away**2 / 3) ** -2
    tint = np.hypot(*(uv_from_xyz(one.xyz) - uv_from_xyz(D65_XYZ)))
    other = 0.12 + 1.5 * (1 + (tint / _WHITE_SIGMA) ** 2 / 3) ** -2
    return float(np.log(lamp / other))


def _reflectable(one: Candidate) -> Floats:
    return np.linspace(0.0, min(MOST_REFLECTED, 0.8 * float(one.xyz[1])), _SHARES)


def _place(one: Candidate, form: ExpectedForm) -> float:
    if form.within is None:
        return -float(np.log1p((one.gap / _NEAR) ** 2))
    # Other things are spread over some widths of the chart about it.
    beyond = max(one.gap / (1.15 * form.within + 0.02) - 1, 0.0)
    return float(np.log1p(3.0 / max(form.within, 0.2)) - 40 * beyond**2 / (1 + 4 * beyond))


def _size(one: Candidate, form: ExpectedForm) -> float:
    sides = np.log([one.thick, one.long])
    other = _log_normal(sides, *_OTHERS)
    if form.size is not None:
        # However odd a size, others have it now and then.
        lamp = float(student(sides - np.log(sorted(form.size)), _STATED))
        return float(np.log(lamp / (np.exp(other) + 1e-4)))
    return float(np.logaddexp(_log_normal(sides, *_STRIPS), _log_normal(sides, *_MODULES)) - np.log(2) - other)


def _log_normal(x: Floats, mean: Floats, covariance: Floats) -> float:
    squared = (x - mean) @ np.linalg.solve(covariance, x - mean)
    return float(-0.5 * squared - 0.5 * np.log(np.linalg.det(2 * np.pi * covariance)))


def _shining(one: Candidate) -> float:
    """A white paper in the light of the chart reads 0.9; from 1.2 on it needs a lamp of its own."""
    bright = 1 / (1 + (1.1 / float(one.xyz[1])) ** 4)
    return float(np.log(bright * np.clip(one.contrast - 1.05, 1e-3, 1.0)))
