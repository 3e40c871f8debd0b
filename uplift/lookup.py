"""Pixels that a cell of their light's table answers: nearly all of them.

A cell that is smooth enough answers at once at the coarser precisions. At full precision its bicubic surface starts
so close that mostly one step of Newton's method is enough, and the cell's curvature says so without another look. What
no cell answers is left for `uplift.reach`.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from uplift.lanes import C0, C1, C2, ERROR, G0, G1, G2, LANES, TERMS, newton_lanes
from uplift.polynomial import TRIES, about, in_nm, stored
from uplift.reach import EXACT
from uplift.surface import CUBIC, CURVED, LINEAR, cubic, linear

PREVIEW, FLOAT, ALL = 0, 1, 2  # precisions
PENDING, STRAY = 5, 6  # a status for what is left, and a count of pixels whose light is none of those given
BLOCK = 4096  # pixels that one thread takes at a time
RUN = 512  # most pixels of one light whose places are kept at a time: they fit into the first-level cache
_SHORT = 64  # pixels that one light lights on end, on average, below which they are sorted by light
_PLACE = 5  # numbers that place a pixel
# Rows of the state of pixels being solved, after those of `newton_lanes`.
_CURVATURE, _AIM, _SCALE, _AT, _STATE = 7, 8, 9, 10, 11
_STEPS = 6  # most steps of Newton's method; all but a few pixels in a thousand take one or two
_CANCELLING = 64.0  # of c2 for λ in nm: from there on the three coefficients are rounded together


@njit(cache=True, error_model="numpy", parallel=True)
def look_up(  # type: ignore[no-untyped-def]
    rgb,
    cluster,
    precision,
    lights,
    axes,
    terms,
    wavelengths,
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

    `axes`, `surfaces`, `coarse`, `grades`, `curvatures` and the pixels' arrays are flat, and so are `terms`, those of
    each light for so many `wavelengths`.
    """
    size = scale.size
    for block in prange(counts.shape[0]):
        start, stop = block * BLOCK, min(size, (block + 1) * BLOCK)
        changes = np.int64(0)
        for at in range(np.uintp(start), np.uintp(stop - 1)):
            changes += np.int64(cluster[at] != cluster[at + np.uintp(1)])
        if changes * _SHORT <= stop - start:
            exact, stray = _block(
                rgb, cluster, start, stop, precision, lights, axes, terms, wavelengths, n, surfaces, coarse, grades,
                curvatures, luminance_weights, a_and_b, coefficients, scale, emission, status,
            )  # fmt: skip
        else:
            # Sorted by light, or most lanes would be empty.
            length = stop - start
            order = _sorted(cluster, start, stop, lights)
            colours, labels = np.empty(3 * length, rgb.dtype), np.empty(length, cluster.dtype)
            for at in range(length):
                labels[at] = cluster[order[at]]
                for channel in range(3):
                    colours[3 * at + channel] = rgb[3 * order[at] + channel]
            c, s, e = np.empty(3 * length), np.empty(length), np.empty(length, emission.dtype)
            kinds = np.empty(length, status.dtype)
            exact, stray = _block(
                colours, labels, 0, length, precision, lights, axes, terms, wavelengths, n, surfaces, coarse, grades,
                curvatures, luminance_weights, a_and_b, c, s, e, kinds,
            )  # fmt: skip
            for at in range(length):
                index = order[at]
                for k in range(3):
                    coefficients[3 * index + k] = c[3 * at + k]
                scale[index], emission[index], status[index] = s[at], e[at], kinds[at]
        counts[block, EXACT], counts[block, STRAY] = exact, stray
        counts[block, PENDING] = stop - start - exact - stray


@njit(cache=True, error_model="numpy")
def _sorted(cluster, start, stop, lights):  # type: ignore[no-untyped-def]
    """Return the indices of the pixels from `start` to `stop`, those of one light after those of another."""
    following = np.zeros(lights + 2, np.int64)
    for at in range(start, stop):
        following[min(np.int64(cluster[at]), lights) + 1] += 1
    for k in range(1, lights + 2):
        following[k] += following[k - 1]
    order = np.empty(stop - start, np.int64)
    for at in range(start, stop):
        k = min(np.int64(cluster[at]), lights)
        order[following[k]] = at
        following[k] += 1
    return order


@njit(cache=True, error_model="numpy")
def _block(  # type: ignore[no-untyped-def]
    rgb, cluster, start, stop, precision, lights, axes, terms, wavelengths, n, surfaces, coarse, grades,
    curvatures, luminance_weights, a_and_b, coefficients, scale, emission, status,
):  # fmt: skip
    """Write the spectra of the pixels from `start` to `stop`; return how many a cell answered, and how many have a light
    that is none of those given.
    """
    places, left, state = np.empty(_PLACE * RUN), np.empty(RUN, np.uint32), np.zeros(_STATE * RUN)
    exact = stray = 0
    while start < stop:
        # Neighbours mostly have the same light: what belongs to it is fetched once for all of them.
        label, length = cluster[start], 1
        while length < min(RUN, stop - start) and cluster[start + length] == label:
            length += 1
        if label >= lights:
            stray += length
            start += length
            continue
        k, first = np.uintp(label), np.uintp(start)
        _place(rgb, first, length, axes, k, n, places)
        many = length
        if precision != ALL:
            many = _answer(
                precision, k, n, surfaces, coarse, grades, a_and_b, first, length, places, left,
                coefficients, scale, emission, status,
            )  # fmt: skip
            exact += length - many
        if many:
            exact += _solve(
                rgb, precision, axes, terms, wavelengths, k, n, surfaces, grades, curvatures, luminance_weights,
                a_and_b, first, many, places, left, state, coefficients, scale, emission, status,
            )  # fmt: skip
        start += length
    return exact, stray


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
    enough = LINEAR | CURVED if precision == PREVIEW else CUBIC
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
    rgb, precision, axes, terms, wavelengths, k, n, surfaces, grades, curvatures, luminance_weights, a_and_b,
    first, many, places, left, state, coefficients, scale, emission, status,
):  # fmt: skip
    """Solve those pixels of a run that are in `left`, all of them at full precision, by whole Newton steps until the next
    residual is small enough; return how many were solved.

    `state` [_STATE · RUN] holds those that are on their way, side by side without gaps.
    """
    begun = _begin(
        rgb, precision, axes, k, n, surfaces, grades, curvatures, luminance_weights, first, many, places, left, state, status
    )  # fmt: skip
    start = k * np.uintp((wavelengths + 1) * TERMS)
    going = begun
    for _ in range(_STEPS):
        for slot in range(0, going, LANES):
            newton_lanes(terms, start, np.uintp(wavelengths), state, np.uintp(RUN), np.uintp(slot))
        going = _finish(precision, k, a_and_b, first, going, state, coefficients, scale, emission, status)
        if not going:
            break
    for slot in range(np.uintp(going)):
        status[first + np.uintp(np.int64(state[slot + np.uintp(_AT * RUN)]))] = PENDING
    return begun - going


@njit(cache=True, error_model="numpy")
def _begin(  # type: ignore[no-untyped-def]
    rgb, precision, axes, k, n, surfaces, grades, curvatures, luminance_weights, first, many, places, left, state, status
):  # fmt: skip
    """Write the state of the pixels that a cell gives a start; return their number."""
    cells, nodes = k * np.uintp(3 * (n - 1) * (n - 1)), k * np.uintp(3 * n * n)
    row, one, two = k * np.uintp(9), np.uintp(1), np.uintp(2)
    begun = 0
    for place in range(np.uintp(many)):
        at = place if precision == ALL else np.uintp(left[place])
        index = first + at
        cell = np.int64(places[at + np.uintp(3 * RUN)])
        if cell < 0 or not grades[cells + np.uintp(cell)]:
            status[index] = PENDING
            continue
        source, largest = index * np.uintp(3), places[at]
        node = nodes + np.uintp(np.int64(places[at + np.uintp(4 * RUN)]))
        c0, c1, c2, dimness = cubic(surfaces, node, n, places[at + np.uintp(RUN)], places[at + np.uintp(2 * RUN)])
        red, green, blue = np.float64(rgb[source]), np.float64(rgb[source + one]), np.float64(rgb[source + two])
        level = 1.0 / (largest * dimness)
        r, g, b = level * red, level * green, level * blue
        y = luminance_weights[0] * red + luminance_weights[1] * green + luminance_weights[2] * blue
        g0 = axes[row] * r + axes[row + one] * g + axes[row + two] * b
        g1 = axes[row + np.uintp(3)] * r + axes[row + np.uintp(4)] * g + axes[row + np.uintp(5)] * b
        g2 = axes[row + np.uintp(6)] * r + axes[row + np.uintp(7)] * g + axes[row + np.uintp(8)] * b
        to = np.uintp(begun)
        state[to + np.uintp(C0 * RUN)] = c0
        state[to + np.uintp(C1 * RUN)] = c1
        state[to + np.uintp(C2 * RUN)] = c2
        state[to + np.uintp(G0 * RUN)] = g0
        state[to + np.uintp(G1 * RUN)] = g1
        state[to + np.uintp(G2 * RUN)] = g2
        state[to + np.uintp(_CURVATURE * RUN)] = curvatures[cells + np.uintp(cell)]
        state[to + np.uintp(_AIM * RUN)] = (1e-14 if precision == ALL else 1e-8) * min(1.0, y / largest)
        state[to + np.uintp(_SCALE * RUN)] = largest * dimness
        state[to + np.uintp(_AT * RUN)] = at
        begun += 1
    return begun


@njit(cache=True, error_model="numpy")
def _finish(precision, k, a_and_b, first, begun, state, coefficients, scale, emission, status):  # type: ignore[no-untyped-def]
    """Write those of the first `begun` pixels in `state` that are solved; move up the others and return their number."""
    kept = 0
    for slot in range(np.uintp(begun)):
        error, curvature = state[slot + np.uintp(ERROR * RUN)], state[slot + np.uintp(_CURVATURE * RUN)]
        # The next residual is at most this, so no need to look. NaN fails this.
        if curvature * error * error <= state[slot + np.uintp(_AIM * RUN)]:
            c0, c1, c2 = (
                state[slot + np.uintp(C0 * RUN)],
                state[slot + np.uintp(C1 * RUN)],
                state[slot + np.uintp(C2 * RUN)],
            )
            c0, c1, c2 = _in_nm(c0, c1, c2, a_and_b[0], a_and_b[1], precision == ALL)
            index = first + np.uintp(np.int64(state[slot + np.uintp(_AT * RUN)]))
            to = index * np.uintp(3)
            coefficients[to] = c0
            coefficients[to + np.uintp(1)] = c1
            coefficients[to + np.uintp(2)] = c2
            scale[index] = state[slot + np.uintp(_SCALE * RUN)]
            emission[index] = k
            status[index] = EXACT
        else:
            for row in range(np.uintp(_STATE)):
                state[row * np.uintp(RUN) + np.uintp(kept)] = state[row * np.uintp(RUN) + slot]
            kept += 1
    return kept


@njit(cache=True, error_model="numpy")
def _in_nm(c0, c1, c2, a, b, exact):  # type: ignore[no-untyped-def]
    """Return coefficients for λ in nm, rounded together where they cancel."""
    n1, n2 = c1 * b - 2.0 * c0 * (a * b * b), c2 - c1 * (a * b) + c0 * ((a * b) * (a * b))
    if exact and abs(n2) > _CANCELLING:
        c0, c1, c2, summit = about(c0, c1, c2, 0.0)
        c0, c1, c2, summit = in_nm(c0, c1, c2, summit, a, b)
        return stored(c0, c1, c2, summit, TRIES)
    return c0 * (b * b), n1, n2
