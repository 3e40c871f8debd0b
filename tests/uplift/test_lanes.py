"""Truth: Newton's step by plain matrices, one pixel at a time; sums by a slow loop."""

import numpy as np
import pytest
from numba import njit

from uplift.lanes import C0, ERROR, G0, LANES, TERMS, newton_lanes, terms_of
from uplift.sigmoid import normalised_wavelengths, sigmoid
from uplift.spectrum import illuminant, observer, rgb_space, rgb_weights

EYES = observer()
T = normalised_wavelengths(EYES)
STRIDE = 2 * LANES
ROUNDING = 1e-14  # of sums of 81 numbers below one
SAME_STEP = 1e-10  # of coefficients near one: the Jacobian of a fluorescent lamp has a condition number of 1e3


@njit(error_model="numpy")
def stepped(terms, start, wavelengths, state, stride, slot):
    newton_lanes(terms, np.uintp(start), np.uintp(wavelengths), state, np.uintp(stride), np.uintp(slot))


def weights_of(name):
    return rgb_weights(illuminant(name, EYES), EYES, rgb_space("ITU-R BT.2020"))


def taken(weights, c, g, terms=None, start=0):
    """Return the state [7, LANES] after one step from c [3, LANES] towards g [3, LANES]."""
    state = np.full((7, STRIDE), np.nan)
    state[C0 : C0 + 3, 3 : 3 + LANES], state[G0 : G0 + 3, 3 : 3 + LANES] = c, g
    stepped(terms_of(weights, T) if terms is None else terms, start, T.size, state.reshape(-1), STRIDE, 3)
    assert np.isnan(state[:, :3]).all() and np.isnan(state[:, 3 + LANES :]).all()
    return state[:, 3 : 3 + LANES]


def shown(weights, c):
    return weights @ sigmoid((c[0] * T + c[1]) * T + c[2])


def truth(weights, c, g):
    """Return c after a step, and the largest residual before it."""
    x = (c[0] * T + c[1]) * T + c[2]
    slope = 0.5 * (1 + x * x) ** -1.5
    residual = g - shown(weights, c)
    jacobian = (weights * slope) @ np.stack([T * T, T, np.ones_like(T)], axis=1)
    return c + np.linalg.solve(jacobian, residual), np.abs(residual).max()


@pytest.fixture
def problem():
    rng = np.random.default_rng(41)
    weights = weights_of("FL2")
    goal = rng.normal(0, 1.5, (3, LANES))
    g = np.stack([shown(weights, c) for c in goal.T], axis=1)
    return weights, goal + rng.normal(0, 0.01, goal.shape), g


def test_a_step_is_newtons_in_every_lane(problem):
    weights, c, g = problem
    state = taken(weights, c, g)
    for lane in range(LANES):
        after, error = truth(weights, c[:, lane], g[:, lane])
        np.testing.assert_allclose(state[C0 : C0 + 3, lane], after, atol=SAME_STEP)
        assert state[ERROR, lane] == pytest.approx(error, abs=ROUNDING)


def test_the_sums_are_as_exact_as_double_precision(problem):
    weights, c, _ = problem
    slow = np.stack([shown(weights, column) for column in c.T], axis=1)
    # At a solution the residual is what the sums are off.
    assert taken(weights, c, slow)[ERROR].max() < ROUNDING


@pytest.mark.parametrize("x", [-3e8, -40.0, 0.0, 7.0, 1e12, 1e17])
def test_flat_reflectances_are_exact_however_steep_the_sigmoid(x):
    weights = weights_of("D65")
    c = np.zeros((3, LANES))
    c[2] = x
    g = np.repeat((weights.sum(axis=1) * sigmoid(x))[:, None], LANES, axis=1)
    assert taken(weights, c, g)[ERROR].max() < ROUNDING


def test_a_lane_depends_on_no_other(problem):
    weights, c, g = problem
    whole = taken(weights, c, g)
    order = np.random.default_rng(42).permutation(LANES)
    np.testing.assert_array_equal(taken(weights, c[:, order], g[:, order]), whole[:, order])
    spoilt = c.copy()
    spoilt[:, 1:] = np.nan
    np.testing.assert_array_equal(taken(weights, spoilt, g)[:, 0], whole[:, 0])


def test_each_light_has_its_own_terms(problem):
    weights, c, g = problem
    both = np.concatenate([terms_of(weights_of("A"), T), terms_of(weights, T)])
    state = taken(weights, c, g, both, (T.size + 1) * TERMS)
    np.testing.assert_array_equal(state, taken(weights, c, g))


@pytest.mark.parametrize("x", [1e25, 1e200, np.inf, np.nan])
def test_what_overflows_or_is_missing_never_looks_solved(x, problem):
    weights, c, g = problem
    c = c.copy()
    c[2] = x
    error = taken(weights, c, g)[ERROR]
    assert not (error < 1.0).any()
