"""Pixels that no cell of a table answers: colours near the border of what their light can show, and beyond it.

Each starts from its light's `Fan` and is solved by Newton's method about its own summit. If its light cannot show it,
the lights of the other clusters are tried, the one of the nearest colour first, then D65, then two lights for the ends
of the range. What none can show is mixed with white.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from uplift.gamut import FIRST_ROW, ROW_STEP
from uplift.newton import solve
from uplift.polynomial import about, in_nm, stored

EXACT, BLACK, FALLBACK, CLOSEST, MISSING = 0, 1, 2, 3, 4  # as `Status` in uplift.pixels
_SOLVED = 1e-12  # residual relative to luminance and the largest component below which a colour counts as reached
_AIM = 1e-15  # the same, where Newton's method stops: a few roundings of the sum
_TRIALS = 6
_ROOM = 0.2  # rows of the fan between the border and a colour that is moved


@njit(cache=True, error_model="numpy")
def _sector(sectors, start, end, G0, G1, G2):  # type: ignore[no-untyped-def]
    """Return (sector, α, β, γ) of a colour."""
    best, found, at_a, at_b, at_c = -np.inf, start, 1.0, 0.0, 0.0
    for j in range(start, end):
        rows = sectors[j]
        beta = rows[1, 0] * G0 + rows[1, 1] * G1 + rows[1, 2] * G2
        gamma = rows[2, 0] * G0 + rows[2, 1] * G1 + rows[2, 2] * G2
        # Both are positive in one sector only, but for rounding.
        if min(beta, gamma) > best and beta + gamma > 0.0:
            best, found, at_b, at_c = min(beta, gamma), j, beta, gamma
            at_a = rows[0, 0] * G0 + rows[0, 1] * G1 + rows[0, 2] * G2
            if best > 0.0:
                break
    return found, at_a, max(at_b, 0.0), max(at_c, 0.0)


@njit(cache=True, error_model="numpy")
def _start(nodes, j, following, p, s):  # type: ignore[no-untyped-def]
    """Return (c0, c1, c2, middle, logarithm of the brightness) between four nodes of the fan."""
    i = min(max(int(p), 0), nodes.shape[1] - 2)
    p = max(p - i, 0.0)
    n, e, w, x = nodes[j, i], nodes[following, i], nodes[j, i + 1], nodes[following, i + 1]
    w0, w1, w2, w3 = (1.0 - p) * (1.0 - s), (1.0 - p) * s, p * (1.0 - s), p * s
    bright = w0 * n[4] + w1 * e[4] + w2 * w[4] + w3 * x[4]
    if max(n[0], e[0], w[0], x[0]) < -2.0:
        # Four peaks: their summits are between each other.
        c0 = w0 * n[0] + w1 * e[0] + w2 * w[0] + w3 * x[0]
        c1 = w0 * n[1] + w1 * e[1] + w2 * w[1] + w3 * x[1]
        c2 = w0 * n[2] + w1 * e[2] + w2 * w[2] + w3 * x[2]
        return c0, c1, c2, w0 * n[3] + w1 * e[3] + w2 * w[3] + w3 * x[3], bright
    c0 = c1 = c2 = 0.0
    for corner in range(4):
        node, share = n, w0
        if corner == 1:
            node, share = e, w1
        elif corner == 2:
            node, share = w, w2
        elif corner == 3:
            node, share = x, w3
        m = node[3]
        c0 += share * node[0]
        c1 += share * (node[1] - 2.0 * node[0] * m)
        c2 += share * ((node[0] * m - node[1]) * m + node[2])
    c0, c1, c2, m = about(c0, c1, c2, 0.0)
    return c0, c1, c2, m, bright


@njit(cache=True, error_model="numpy")
def _kind_of(luminance_weights, red, green, blue):  # type: ignore[no-untyped-def]
    """Return (kind, size, luminance): EXACT where there is something to solve."""
    size = max(abs(red), abs(green), abs(blue))
    if not np.isfinite(red + green + blue):
        return MISSING, 1.0, 0.0
    if size == 0.0:
        return BLACK, 1.0, 0.0
    # Divided first: the luminance of the smallest numbers would be zero.
    y = (
        luminance_weights[0] * (red / size)
        + luminance_weights[1] * (green / size)
        + luminance_weights[2] * (blue / size)
    )
    # What has no luminance is outside of every cone of light.
    return EXACT if y > 0.0 else CLOSEST, size, y


@njit(cache=True, error_model="numpy")
def _share(p, alpha, rest, white):  # type: ignore[no-untyped-def]
    """Return the share of white of the same luminance, of X + Y + Z `white`, that brings a colour to row `p`."""
    part = 1.0 / (1.0 + np.exp(FIRST_ROW + ROW_STEP * p))
    wanted = part * (alpha + rest) - alpha
    return wanted / (wanted + white * (1.0 - part))


@njit(cache=True, error_model="numpy")
def _settled(  # type: ignore[no-untyped-def]
    red,
    green,
    blue,
    own,
    order,
    axes,
    white_sums,
    luminance_weights,
    weights,
    wavelengths,
    a,
    b,
    sectors,
    nodes,
    reach,
    firsts,
    tries,
):
    """Return (kind, light, c0, c1, c2, scale) of any pixel at all."""
    kind, size, y = _kind_of(luminance_weights, red, green, blue)
    if kind != EXACT:
        return kind, own, 0.0, 0.0, -np.inf, 0.0
    red, green, blue = red / size, green / size, blue / size
    lights = order.shape[1]
    least, mixed_with = np.inf, own
    for turn in range(lights + 1):
        closest = turn == lights
        light = mixed_with if closest else order[own, turn]
        G0 = axes[light, 0, 0] * red + axes[light, 0, 1] * green + axes[light, 0, 2] * blue
        G1 = axes[light, 1, 0] * red + axes[light, 1, 1] * green + axes[light, 1, 2] * blue
        G2 = axes[light, 2, 0] * red + axes[light, 2, 1] * green + axes[light, 2, 2] * blue
        j, alpha, beta, gamma = _sector(sectors, firsts[light], firsts[light + 1], G0, G1, G2)
        following = j + 1 if j + 1 < firsts[light + 1] else firsts[light]
        rest = beta + gamma
        s = gamma / rest if rest > 0.0 else 0.0
        white = y * white_sums[light]
        limit = min(reach[j], reach[following]) - 1.0
        p = np.inf
        if rest <= np.exp(FIRST_ROW) * alpha:
            p = 0.0
        elif alpha > 0.0:
            p = (np.log(rest / alpha) - FIRST_ROW) / ROW_STEP
        within = p <= limit
        for trial in range(40 if closest else _TRIALS):
            share = 0.0
            if closest:
                p = max(0.0, limit - _ROOM - trial)
                share = _share(p, alpha, rest, white)
            elif not within:
                break
            M0, M1, M2 = G0 + share * (y - G0), G1 + share * (y - G1), G2 + share * (y - G2)
            total = (1.0 - share) * (alpha + rest) + share * white
            if trial == 0 or closest:
                c0, c1, c2, middle, bright = _start(nodes, j, following, p, s)
            else:
                # A node itself, and darker colours than its own.
                node = nodes[j if s < 0.5 else following, min(int(p), nodes.shape[1] - 1)]
                x = 1.4 ** (trial - 1)
                c0, c1, c2, middle, bright = x * node[0], x * node[1], x * node[2], node[3], node[4] - 2.0 * np.log(x)
            bright = np.exp(bright) / total
            c0, c1, c2, nm = in_nm(c0, c1, c2, middle, a, b)
            # An error counts relative to luminance: beside the blue of a candle, everything else is small.
            small = bright * min(y, max(M0, M1, M2))
            c0, c1, c2, error = solve(
                weights[light], wavelengths, nm, bright * M0, bright * M1, bright * M2, c0, c1, c2, _AIM * small, 24
            )
            if error <= _SOLVED * small:
                kind = CLOSEST if closest else (EXACT if turn == 0 else FALLBACK)
                c0, c1, c2 = stored(c0, c1, c2, nm, tries)
                return kind, light, c0, c1, c2, size / bright
        # Only white of its own light, or of D65, after which two others come.
        if turn == 0 or turn == lights - 3:
            share = _share(min(limit, p) - _ROOM, alpha, rest, white)
            if share < least:
                least, mixed_with = share, light
    return CLOSEST, own, 0.0, 0.0, -np.inf, 0.0


@njit(cache=True, error_model="numpy", parallel=True)
def settle(  # type: ignore[no-untyped-def]
    where,
    rgb,
    cluster,
    order,
    axes,
    white_sums,
    luminance_weights,
    weights,
    wavelengths,
    a_and_b,
    sectors,
    nodes,
    reach,
    firsts,
    tries,
    coefficients,
    scale,
    emission,
    status,
):
    """Solve the pixels `where` [M] of colours `rgb` [M, 3] and lights `cluster` [M]; write them to the four last."""
    for n in prange(where.size):
        index = where[n]
        kind, light, c0, c1, c2, brightness = _settled(
            rgb[n, 0],
            rgb[n, 1],
            rgb[n, 2],
            np.int64(cluster[n]),
            order,
            axes,
            white_sums,
            luminance_weights,
            weights,
            wavelengths,
            a_and_b[0],
            a_and_b[1],
            sectors,
            nodes,
            reach,
            firsts,
            tries,
        )
        coefficients[index, 0] = c0
        coefficients[index, 1] = c1
        coefficients[index, 2] = c2
        scale[index] = brightness
        emission[index] = light
        status[index] = kind
