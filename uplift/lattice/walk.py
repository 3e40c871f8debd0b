"""The walk to the cell that holds a colour, in compiled code.

A cell (i, j, k) maps the position (u, v, w) in 0 … 1 to a colour by trilinear interpolation between its eight corners'
colours. Neighbouring cells share the bilinear faces between them, so the cells fill the lattice without gaps.
"""

from __future__ import annotations

import numpy as np
from numba import njit

# How far outside 0 … 1 a position may be: the rounding of corners that lie on the border of the lattice. It is kept as
# it is, so the mixture stays exact.
_EDGE = 1e-12
_OUTSIDE = -1


@njit(cache=True, error_model="numpy")
def interpolated(rgb, i, j, k, u, v, w, channel):  # type: ignore[no-untyped-def]
    """Return a component of the colour at (u, v, w) of a cell, and its derivatives by u, v and w."""
    a000, a001 = rgb[i, j, k, channel], rgb[i, j, k + 1, channel]
    a010, a011 = rgb[i, j + 1, k, channel], rgb[i, j + 1, k + 1, channel]
    a100, a101 = rgb[i + 1, j, k, channel], rgb[i + 1, j, k + 1, channel]
    a110, a111 = rgb[i + 1, j + 1, k, channel], rgb[i + 1, j + 1, k + 1, channel]
    b00, b01 = (1.0 - w) * a000 + w * a001, (1.0 - w) * a010 + w * a011
    b10, b11 = (1.0 - w) * a100 + w * a101, (1.0 - w) * a110 + w * a111
    near, far = (1.0 - v) * b00 + v * b01, (1.0 - v) * b10 + v * b11
    by_v = (1.0 - u) * (b01 - b00) + u * (b11 - b10)
    by_w = (1.0 - u) * ((1.0 - v) * (a001 - a000) + v * (a011 - a010)) + u * (
        (1.0 - v) * (a101 - a100) + v * (a111 - a110)
    )
    return (1.0 - u) * near + u * far, far - near, by_v, by_w


@njit(cache=True, error_model="numpy")
def _invert(rgb, i, j, k, r, g, b):  # type: ignore[no-untyped-def]
    """Return (held, u, v, w) with the colour (r, g, b), by Newton's method from the middle of the cell.

    Stops as soon as it is clear that the cell does not hold the colour; (u, v, w) then tell the way.
    """
    u = v = w = 0.5
    before = np.inf
    for step in range(30):
        f0, a, d, m = interpolated(rgb, i, j, k, u, v, w, 0)
        f1, e, f, h = interpolated(rgb, i, j, k, u, v, w, 1)
        f2, p, q, s = interpolated(rgb, i, j, k, u, v, w, 2)
        r0, r1, r2 = r - f0, g - f1, b - f2
        A, B, C = f * s - h * q, h * p - e * s, e * q - f * p
        determinant = a * A + d * B + m * C
        if determinant == 0.0:
            return False, u, v, w
        du = (A * r0 + (m * q - d * s) * r1 + (d * h - m * f) * r2) / determinant
        dv = (B * r0 + (a * s - m * p) * r1 + (m * e - a * h) * r2) / determinant
        dw = (C * r0 + (d * p - a * q) * r1 + (a * f - d * e) * r2) / determinant
        u, v, w = u + du, v + dv, w + dw
        moved = max(abs(du), abs(dv), abs(dw))
        # Below 1e-9 steps shrink quadratically until rounding stops them: the one that no longer does is the last.
        if moved < 1e-15 or (moved < 1e-9 and not moved < before):
            low, high = min(u, v, w), max(u, v, w)
            return low >= -_EDGE and high <= 1.0 + _EDGE, u, v, w
        if step > 1 and (min(u, v, w) < -0.5 or max(u, v, w) > 1.5):
            return False, u, v, w
        before = moved
    return False, u, v, w


@njit(cache=True, error_model="numpy")
def _stride(x):  # type: ignore[no-untyped-def]
    """Return how many cells to move for a position: to the neighbour, or further where that is clearly not enough."""
    if x < -_EDGE:
        return max(int(np.floor(x)), -8) if x > -1e6 else -8
    if x > 1.0 + _EDGE:
        return min(int(np.ceil(x)) - 1, 8) if x < 1e6 else 8
    return 0


@njit(cache=True, error_model="numpy")
def _in_box(box, r, g, b):  # type: ignore[no-untyped-def]
    return box[0] <= r <= box[3] and box[1] <= g <= box[4] and box[2] <= b <= box[5]


@njit(cache=True, error_model="numpy")
def locate(rgb, boxes, rows, white, r, g, b):  # type: ignore[no-untyped-def]
    """Return (cell, u, v, w, visited) of the cell that holds a colour; cell −1 if none does.

    `visited` counts the cells of the walk, and of the search that follows where it fails.
    """
    side = rgb.shape[0] - 1
    i = min(max(int(r / white[0] * side), 0), side - 1) if white[0] > 0.0 else 0
    j = min(max(int(g / white[1] * side), 0), side - 1) if white[1] > 0.0 else 0
    k = min(max(int(b / white[2] * side), 0), side - 1) if white[2] > 0.0 else 0
    visited = 0
    for _ in range(side):  # more is a walk in circles
        cell = (i * side + j) * side + k
        if boxes[cell, 0] > boxes[cell, 3]:
            break  # empty
        visited += 1
        held, u, v, w = _invert(rgb, i, j, k, r, g, b)
        if held:
            return cell, u, v, w, visited
        if not np.isfinite(u + v + w):
            break
        x = min(max(i + _stride(u), 0), side - 1)
        y = min(max(j + _stride(v), 0), side - 1)
        z = min(max(k + _stride(w), 0), side - 1)
        if x == i and y == j and z == k:
            break  # at the border of the lattice
        i, j, k = x, y, z
    for row in range(rows.shape[0]):
        if not _in_box(rows[row], r, g, b):
            continue
        for cell in range(row * side, row * side + side):
            if _in_box(boxes[cell], r, g, b):
                visited += 1
                held, u, v, w = _invert(rgb, row // side, row % side, cell % side, r, g, b)
                if held:
                    return cell, u, v, w, visited
    return _OUTSIDE, 0.0, 0.0, 0.0, visited


@njit(cache=True, error_model="numpy")
def nearest(rgb, boxes, r, g, b):  # type: ignore[no-untyped-def]
    """Return (cell, u, v, w): the nearest colour in the cells around the nearest node.

    Interpolation is linear in each of u, v, w, so each has its best value in closed form while the others stand still;
    going round them lowers the distance with each turn.
    """
    n, side = rgb.shape[0], rgb.shape[0] - 1
    best, at_i, at_j, at_k = np.inf, 0, 0, 0
    for i in range(n):
        for j in range(n):
            for k in range(n):
                distance = (rgb[i, j, k, 0] - r) ** 2 + (rgb[i, j, k, 1] - g) ** 2 + (rgb[i, j, k, 2] - b) ** 2
                if distance < best and _in_a_cell(boxes, side, i, j, k):
                    best, at_i, at_j, at_k = distance, i, j, k
    best, best_cell, best_u, best_v, best_w = np.inf, 0, 0.0, 0.0, 0.0
    for around in range(8):
        i, j, k = at_i - around // 4, at_j - around // 2 % 2, at_k - around % 2
        if min(i, j, k) < 0 or max(i, j, k) >= side:
            continue
        cell = (i * side + j) * side + k
        if boxes[cell, 0] > boxes[cell, 3]:
            continue
        u, v, w = float(at_i - i), float(at_j - j), float(at_k - k)
        for turn in range(120):
            f0, a, d, m = interpolated(rgb, i, j, k, u, v, w, 0)
            f1, e, f, h = interpolated(rgb, i, j, k, u, v, w, 1)
            f2, p, q, s = interpolated(rgb, i, j, k, u, v, w, 2)
            r0, r1, r2 = r - f0, g - f1, b - f2
            if turn % 3 == 0:
                u = min(max(u + (a * r0 + e * r1 + p * r2) / (a * a + e * e + p * p), 0.0), 1.0)
            elif turn % 3 == 1:
                v = min(max(v + (d * r0 + f * r1 + q * r2) / (d * d + f * f + q * q), 0.0), 1.0)
            else:
                w = min(max(w + (m * r0 + h * r1 + s * r2) / (m * m + h * h + s * s), 0.0), 1.0)
        f0 = interpolated(rgb, i, j, k, u, v, w, 0)[0]
        f1 = interpolated(rgb, i, j, k, u, v, w, 1)[0]
        f2 = interpolated(rgb, i, j, k, u, v, w, 2)[0]
        distance = (r - f0) ** 2 + (g - f1) ** 2 + (b - f2) ** 2
        if distance < best:
            best, best_cell, best_u, best_v, best_w = distance, cell, u, v, w
    return best_cell, best_u, best_v, best_w


@njit(cache=True, error_model="numpy")
def _in_a_cell(boxes, side, i, j, k):  # type: ignore[no-untyped-def]
    """Return whether a node is the corner of a cell that is not empty."""
    for around in range(8):
        x, y, z = i - around // 4, j - around // 2 % 2, k - around % 2
        if min(x, y, z) >= 0 and max(x, y, z) < side:
            cell = (x * side + y) * side + z
            if boxes[cell, 0] <= boxes[cell, 3]:
                return True
    return False
