"""Between the nodes of a table: bilinear and bicubic surfaces, and how good they are in each cell.

Every cell is tried at five points when its table is built, and its grade says whether linear or cubic interpolation
answers a colour by itself, or at least gives a start from which Newton's method converges at once.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from llvmlite import ir
from numba import njit, prange, types
from numba.extending import intrinsic

from uplift.difference import delta_e_2000
from uplift.newton import integrals, newton
from uplift.sigmoid import SUMS
from uplift.spectrum import Float64, RGBSpace

PREVIEW_DELTA_E, FLOAT_DELTA_E = 0.05, 1e-4  # ΔE2000 that the two coarser precisions allow
# Bits of a cell's grade: a start for Newton's method; linear interpolation good enough for previews; cubic interpolation
# good enough for float; cubic interpolation good enough for previews.
USABLE, LINEAR, CUBIC, CURVED = 1, 2, 4, 8
# Coefficients for t above which a peak is narrow enough to be solved about its own summit.
_NARROW = 400.0


def surface_of(nodes: Float64) -> Float64:
    """Return [3, n, n, 4, 4]: coefficients and 1/level of each node; second last the value, its derivatives along i,
    along j, and along both.
    """
    values = nodes.copy()
    values[..., 3] = 1 / nodes[..., 3]
    along_i, along_j = _slopes(values, 1), _slopes(values, 2)
    return np.ascontiguousarray(np.stack([values, along_i, along_j, _slopes(along_i, 2)], axis=3))


def _slopes(values: Float64, axis: int) -> Float64:
    """Return the derivative of `values` along `axis`, per node: differences of fourth order where there are five."""
    f = np.moveaxis(values, axis, 0)
    out = np.gradient(f, axis=0)
    if len(f) >= 5:
        out[2:-2] = (f[:-4] - 8 * f[1:-3] + 8 * f[3:-1] - f[4:]) / 12
        for end, sign in ((f[:5], 1), (f[::-1][:5], -1)):
            e0, e1, e2, e3, e4 = end
            at = 0 if sign > 0 else -1
            out[at] = sign * (-25 * e0 + 48 * e1 - 36 * e2 + 16 * e3 - 3 * e4) / 12
            out[at + sign] = sign * (-3 * e0 - 10 * e1 + 18 * e2 - 6 * e3 + e4) / 12
    return np.moveaxis(out, 0, axis)


def grades_of(
    weights: Float64,
    t: Float64,
    nodes: Float64,
    solved: npt.NDArray[np.bool_],
    surface: Float64,
    rgb_from_axes: Float64,
    space: RGBSpace,
) -> tuple[npt.NDArray[np.uint8], Float64]:
    """Return grades and curvature [3, n-1, n-1] of the cells of a table: what each is good for, and C such that a Newton
    step from there leaves a residual below C times the square of the one before.
    """
    cells = nodes.shape[1] - 1
    curvature = np.empty((3, cells, cells))
    asked, shown = np.ones((3, cells, cells, 2, 3)), np.ones((3, cells, cells, 2, 3))
    flat = np.ascontiguousarray(surface[..., 0, :]).reshape(-1)
    _tried(weights, t, nodes, solved, surface.reshape(-1), flat, curvature, asked, shown)
    difference = delta_e_2000(asked @ rgb_from_axes.T, shown @ rgb_from_axes.T, space, white=None)
    usable = np.isfinite(curvature)
    # Twice and four times: the worst point of a cell was not among those tried.
    linear_enough = usable & (difference[..., 0] * 2 <= PREVIEW_DELTA_E)
    cubic_enough = usable & (difference[..., 1] * 4 <= FLOAT_DELTA_E)
    # Ten times: stiffer cells are among these, and one under FL11 had six times what its points told.
    curved_enough = usable & (difference[..., 1] * 10 <= PREVIEW_DELTA_E)
    grades = usable * USABLE + linear_enough * LINEAR + cubic_enough * CUBIC + curved_enough * CURVED
    return grades.astype(np.uint8), curvature


# The three below take flat arrays and one unsigned index. A slice would count a reference more and less in each pixel,
# for which the threads wait for each other; a signed index could be negative, which takes a choice more.


@intrinsic
def _blend(_, values, starts, weights):  # type: ignore[no-untyped-def]
    """Return Σ weight · values[start : start + 4] over two tuples, as four numbers side by side in one SIMD register: the
    compiler finds such sums in loops only, and these four are too few to be one.
    """
    count = len(weights)

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        array = context.make_array(values)(context, builder, arguments[0])
        double, lane = ir.DoubleType(), ir.IntType(32)
        four = ir.VectorType(double, 4)
        total = ir.Constant(four, [0.0] * 4)
        for k in range(count):
            place = builder.gep(array.data, [builder.extract_value(arguments[1], k)])
            node = builder.load(builder.bitcast(place, four.as_pointer()), align=8, typ=four)
            weight = builder.insert_element(
                ir.Constant(four, ir.Undefined), builder.extract_value(arguments[2], k), lane(0)
            )
            weight = builder.shuffle_vector(
                weight, ir.Constant(four, ir.Undefined), ir.Constant(ir.VectorType(lane, 4), [0] * 4)
            )
            total = builder.fadd(total, builder.fmul(weight, node, flags=("contract",)), flags=("contract",))
        lanes = [builder.extract_element(total, lane(k)) for k in range(4)]
        return context.make_tuple(builder, signature.return_type, lanes)

    return types.UniTuple(types.float64, 4)(values, starts, weights), generate


@njit(cache=True, error_model="numpy", fastmath=SUMS)
def cubic(surface, node, n, p, q):  # type: ignore[no-untyped-def]
    """Return (c0, c1, c2, 1/level) at (p, q) in 0 … 1 within a cell of the flat `surface`, of `n` nodes an axis, given
    the cell's first node: Hermite's cubics both ways. For compiled code only.
    """
    p2, q2 = p * p, q * q
    a1, b1 = (3.0 - 2.0 * p) * p2, (3.0 - 2.0 * q) * q2
    a0, b0 = 1.0 - a1, 1.0 - b1
    u1, v1 = (p - 1.0) * p2, (q - 1.0) * q2
    u0, v0 = p - p2 + u1, q - q2 + v1
    a = node * np.uintp(16)
    c = a + np.uintp(n) * np.uintp(16)
    b, d = a + np.uintp(16), c + np.uintp(16)
    one, two, three = np.uintp(4), np.uintp(8), np.uintp(12)
    starts = (
        a, a + one, a + two, a + three, b, b + one, b + two, b + three,
        c, c + one, c + two, c + three, d, d + one, d + two, d + three,
    )  # fmt: skip
    weights = (
        a0 * b0, u0 * b0, a0 * v0, u0 * v0, a0 * b1, u0 * b1, a0 * v1, u0 * v1,
        a1 * b0, u1 * b0, a1 * v0, u1 * v0, a1 * b1, u1 * b1, a1 * v1, u1 * v1,
    )  # fmt: skip
    return _blend(surface, starts, weights)


@njit(cache=True, error_model="numpy", fastmath=SUMS)
def linear(values, node, n, p, q):  # type: ignore[no-untyped-def]
    """Return four values at (p, q) in 0 … 1 within a cell of the flat `values`, of `n` nodes an axis, given the cell's
    first node: bilinear. For compiled code only.
    """
    a = node * np.uintp(4)
    c = a + np.uintp(n) * np.uintp(4)
    weights = ((1.0 - p) * (1.0 - q), (1.0 - p) * q, p * (1.0 - q), p * q)
    return _blend(values, (a, a + np.uintp(4), c, c + np.uintp(4)), weights)


@njit(cache=True, error_model="numpy")
def permuted(m, largest, second, third):  # type: ignore[no-untyped-def]
    """Return a colour in the order of the axes, given its components m, m + 1 and m + 2 (modulo 3)."""
    if m == 0:
        return largest, second, third
    if m == 1:
        return third, largest, second
    return second, third, largest


@njit(cache=True, error_model="numpy")
def _cell(weights, t, nodes, solved, surface, flat, m, i, j, asked, shown):  # type: ignore[no-untyped-def]
    """Try one cell; write the colours to `asked` and `shown` [2, 3], and return its curvature."""
    n = nodes.shape[1]
    if not (solved[m, i, j] and solved[m, i, j + 1] and solved[m, i + 1, j] and solved[m, i + 1, j + 1]):
        return np.inf
    steepest = max(abs(nodes[m, i, j, 0]), abs(nodes[m, i, j + 1, 0]))
    if max(steepest, abs(nodes[m, i + 1, j, 0]), abs(nodes[m, i + 1, j + 1, 0])) > _NARROW:
        return np.inf
    largest = g0 = g1 = g2 = 0.0
    node = np.uintp((m * n + i) * n + j)
    for point in range(6):
        # First the middle by both ways, then the four quarters.
        p, q = 0.5, 0.5
        if point > 1:
            p, q = 0.25 + 0.5 * (point % 2), 0.25 + 0.5 * (point // 4)
        d0, d1, d2 = permuted(m, 1.0, (i + p) / (n - 1), (j + q) / (n - 1))
        if point == 0:
            c0, c1, c2, dimness = linear(flat, node, n, p, q)
        else:
            c0, c1, c2, dimness = cubic(surface, node, n, p, q)
        f = integrals(weights, t, 0.0, c0, c1, c2)
        f0, f1, f2 = f[0] * dimness, f[1] * dimness, f[2] * dimness
        error = max(abs(f0 - d0), abs(f1 - d1), abs(f2 - d2)) / dimness
        # Not "greater": that would let NaN pass.
        if point == 0 or not error <= largest:
            way = min(point, 1)
            asked[way, 0], asked[way, 1], asked[way, 2] = d0, d1, d2
            shown[way, 0], shown[way, 1], shown[way, 2] = f0, f1, f2
        if point > 0:
            largest = max(largest, error)
        if point == 1:
            g0, g1, g2 = d0 / dimness, d1 / dimness, d2 / dimness
    before, after = 1.0, 1.0
    c0, c1, c2 = nodes[m, i, j, 0], nodes[m, i, j, 1], nodes[m, i, j, 2]
    for _ in range(2):
        before = after
        c0, c1, c2, after = newton(weights, t, g0, g1, g2, c0, c1, c2)
    found = 4.0 * after / (before * before)
    return found if found * largest < 0.5 else np.inf


@njit(cache=True, error_model="numpy", parallel=True)
def _tried(weights, t, nodes, solved, surface, flat, curvature, asked, shown):  # type: ignore[no-untyped-def]
    """Write curvature [3, n-1, n-1], and colours asked and shown [3, n-1, n-1, 2, 3]: the middle of each cell looked
    up linearly, and the worst of five points looked up cubically.

    The curvature is measured on the way from a corner to the middle. Infinite where a corner is unsolved or narrow, or
    Newton's method would not converge quickly.
    """
    cells = curvature.shape[1]
    for line in prange(3 * cells):
        m, i = line // cells, line % cells
        for j in range(cells):
            curvature[m, i, j] = _cell(
                weights, t, nodes, solved, surface, flat, m, i, j, asked[m, i, j], shown[m, i, j]
            )
