"""Pixels that a cell of their light's table answers: nearly all of them.

A cell that is smooth enough answers at once at the coarser precisions. At full precision its bicubic surface starts
so close that mostly one step of Newton's method is enough, and the cell's curvature says so without another look. What
no cell answers is left for `uplift.reach`.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from uplift.newton import newton
from uplift.polynomial import TRIES, about, in_nm, stored
from uplift.reach import EXACT
from uplift.surface import CUBIC, LINEAR, cubic, linear

PREVIEW, FLOAT, ALL = 0, 1, 2  # precisions
PENDING = 5  # a status for what is left
BLOCK = 4096  # pixels that one thread takes at a time
RUN = 512  # most pixels of one light whose places are kept at a time: they fit into the first-level cache
_PLACE = 5  # numbers that place a pixel
_CANCELLING = 64.0  # of c2 for λ in nm: from there on the three coefficients are rounded together


@njit(cache=True, error_model="numpy", parallel=True)
def look_up(  # type: ignore[no-untyped-def]
    rgb,
    cluster,
    precision,
    axes,
    weights,
    t,
    n,
    surfaces,
    coarse,
    grades,
    curvatures,
    luminance_weights,
    a_and_b,
    coefficients,
    scale,
    emission,
    status,
    counts,
):
    """Write the spectra of all pixels of `rgb` that a cell answers, and status PENDING for the others.

    `axes`, `surfaces`, `coarse`, `grades`, `curvatures` and the pixels' arrays are flat; `weights` is [K, 3, N].
    """
    size = scale.size
    for block in prange(counts.shape[0]):
        places, left = np.empty(_PLACE * RUN), np.empty(RUN, np.uint32)
        start, stop = block * BLOCK, min(size, (block + 1) * BLOCK)
        counts[block, PENDING] = stop - start
        while start < stop:
            # Neighbours mostly have the same light: what belongs to it is fetched once for all of them.
            label, length = cluster[start], 1
            while length < min(RUN, stop - start) and cluster[start + length] == label:
                length += 1
            k, first = np.uintp(label), np.uintp(start)
            _place(rgb, first, length, axes, k, n, places)
            many, exact = length, 0
            if precision != ALL:
                many = _answer(
                    precision, k, n, surfaces, coarse, grades, a_and_b, first, length, places, left,
                    coefficients, scale, emission, status,
                )  # fmt: skip
                exact = length - many
            if many:
                exact += _solve(
                    rgb, precision, axes, weights[k], t, k, n, surfaces, grades, curvatures, luminance_weights, a_and_b,
                    first, many, places, left, coefficients, scale, emission, status,
                )  # fmt: skip
            counts[block, EXACT] += exact
            counts[block, PENDING] -= exact
            start += length


@njit(cache=True, error_model="numpy")
def _place(rgb, first, length, axes, k, n, places):  # type: ignore[no-untyped-def]
    """Write what finds the cells of a run of pixels to `places` [5 · RUN]: the largest component, the place in the cell
    twice, the flat index of the cell within the light's table, −1 outside of it, and that of the cell's first node.

    All of them numbers of one kind, in one array and without a branch: so this runs in SIMD lanes. No fast mathematics
    here, which could round a run's last pixels differently.
    """
    one, two, row = np.uintp(1), np.uintp(2), k * np.uintp(9)
    a, b, c = axes[row], axes[row + one], axes[row + two]
    row += np.uintp(3)
    d, e, f = axes[row], axes[row + one], axes[row + two]
    row += np.uintp(3)
    g, h, i = axes[row], axes[row + one], axes[row + two]
    nodes, cells, last = np.float64(n), np.float64(n - 1), np.float64(n - 2)
    for at in range(np.uintp(length)):
        source = (first + at) * np.uintp(3)
        # Not float(): that leaves a float32 one, and the division below would round to 24 bits.
        red, green, blue = np.float64(rgb[source]), np.float64(rgb[source + one]), np.float64(rgb[source + two])
        G0 = a * red + b * green + c * blue
        G1 = d * red + e * green + f * blue
        G2 = g * red + h * green + i * blue
        is_0, is_1 = (G0 >= G1) & (G0 >= G2), G1 >= G2
        largest = G0 if is_0 else (G1 if is_1 else G2)
        p = G1 if is_0 else (G2 if is_1 else G0)
        q = G2 if is_0 else (G0 if is_1 else G1)
        m = 0.0 if is_0 else (1.0 if is_1 else 2.0)
        # The reciprocals of such numbers are numbers too. NaN fails this.
        inside = (largest > 1e-290) & (largest < 1e290) & (p >= 0.0) & (q >= 0.0)
        scaled = 1.0 / largest
        p, q = p * scaled * cells, q * scaled * cells
        i0, j0 = np.floor(p), np.floor(q)
        i0, j0 = (i0 if i0 < last else last), (j0 if j0 < last else last)
        places[at] = largest
        places[at + np.uintp(RUN)] = p - i0
        places[at + np.uintp(2 * RUN)] = q - j0
        places[at + np.uintp(3 * RUN)] = (m * cells + i0) * cells + j0 if inside else -1.0
        places[at + np.uintp(4 * RUN)] = (m * nodes + i0) * nodes + j0


@njit(cache=True, error_model="numpy")
def _answer(  # type: ignore[no-untyped-def]
    precision, k, n, surfaces, coarse, grades, a_and_b, first, length, places, left, coefficients, scale, emission, status
):  # fmt: skip
    """Answer the pixels of a run whose cell is smooth enough; write the others to `left` and return their number."""
    a, b = a_and_b[0], a_and_b[1]
    bb, abb2, ab, abab = b * b, 2.0 * (a * b * b), a * b, (a * b) * (a * b)
    enough = LINEAR | CUBIC if precision == PREVIEW else CUBIC
    cells, nodes = k * np.uintp(3 * (n - 1) * (n - 1)), k * np.uintp(3 * n * n)
    many = 0
    for at in range(np.uintp(length)):
        cell = np.int64(places[at + np.uintp(3 * RUN)])
        grade = np.int64(grades[cells + np.uintp(cell)]) if cell >= 0 else 0
        if not grade & enough:
            left[many] = at
            many += 1
            continue
        p, q = places[at + np.uintp(RUN)], places[at + np.uintp(2 * RUN)]
        node = nodes + np.uintp(np.int64(places[at + np.uintp(4 * RUN)]))
        if precision == PREVIEW and grade & LINEAR:
            c0, c1, c2, dimness = linear(coarse, node, n, p, q)
        else:
            c0, c1, c2, dimness = cubic(surfaces, node, n, p, q)
            c0, c1, c2 = c0 * bb, c1 * b - c0 * abb2, c2 - c1 * ab + c0 * abab
        index = first + at
        to = index * np.uintp(3)
        coefficients[to] = c0
        coefficients[to + np.uintp(1)] = c1
        coefficients[to + np.uintp(2)] = c2
        scale[index] = places[at] * dimness
        emission[index] = k
        status[index] = EXACT
    return many


@njit(cache=True, error_model="numpy")
def _solve(  # type: ignore[no-untyped-def]
    rgb, precision, axes, weights, t, k, n, surfaces, grades, curvatures, luminance_weights, a_and_b,
    first, many, places, left, coefficients, scale, emission, status,
):  # fmt: skip
    """Solve those pixels of a run that are in `left`, all of them at full precision, by whole Newton steps until the next
    residual is small enough; return how many were solved.
    """
    cells, nodes = k * np.uintp(3 * (n - 1) * (n - 1)), k * np.uintp(3 * n * n)
    row, one, two = k * np.uintp(9), np.uintp(1), np.uintp(2)
    solved = 0
    for place in range(np.uintp(many)):
        at = place if precision == ALL else np.uintp(left[place])
        index = first + at
        to = index * np.uintp(3)
        largest, cell = places[at], np.int64(places[at + np.uintp(3 * RUN)])
        c0 = c1 = c2 = dimness = 0.0
        kind = PENDING
        if cell >= 0 and grades[cells + np.uintp(cell)]:
            node = nodes + np.uintp(np.int64(places[at + np.uintp(4 * RUN)]))
            c0, c1, c2, dimness = cubic(surfaces, node, n, places[at + np.uintp(RUN)], places[at + np.uintp(2 * RUN)])
            red, green, blue = np.float64(rgb[to]), np.float64(rgb[to + one]), np.float64(rgb[to + two])
            level = 1.0 / (largest * dimness)
            r, g, b = level * red, level * green, level * blue
            g0 = axes[row] * r + axes[row + one] * g + axes[row + two] * b
            g1 = axes[row + np.uintp(3)] * r + axes[row + np.uintp(4)] * g + axes[row + np.uintp(5)] * b
            g2 = axes[row + np.uintp(6)] * r + axes[row + np.uintp(7)] * g + axes[row + np.uintp(8)] * b
            y = luminance_weights[0] * red + luminance_weights[1] * green + luminance_weights[2] * blue
            aim = (1e-14 if precision == ALL else 1e-8) * min(1.0, y / largest)
            curvature = curvatures[cells + np.uintp(cell)]
            for _ in range(6):
                c0, c1, c2, error = newton(weights, t, g0, g1, g2, c0, c1, c2)
                # The next residual is at most this, so no need to look.
                if curvature * error * error <= aim:
                    kind = EXACT
                    break
            c0, c1, c2 = _in_nm(c0, c1, c2, a_and_b[0], a_and_b[1], precision == ALL)
        coefficients[to] = c0
        coefficients[to + one] = c1
        coefficients[to + two] = c2
        scale[index] = largest * dimness
        emission[index] = k
        status[index] = kind
        solved += kind == EXACT
    return solved


@njit(cache=True, error_model="numpy")
def _in_nm(c0, c1, c2, a, b, exact):  # type: ignore[no-untyped-def]
    """Return coefficients for λ in nm, rounded together where they cancel."""
    n1, n2 = c1 * b - 2.0 * c0 * (a * b * b), c2 - c1 * (a * b) + c0 * ((a * b) * (a * b))
    if exact and abs(n2) > _CANCELLING:
        c0, c1, c2, summit = about(c0, c1, c2, 0.0)
        c0, c1, c2, summit = in_nm(c0, c1, c2, summit, a, b)
        return stored(c0, c1, c2, summit, TRIES)
    return c0 * (b * b), n1, n2
