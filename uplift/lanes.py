"""Newton's step for several pixels of one light at a time, each in a SIMD lane of its own.

Every lane goes through the wavelengths in their order, so no sum is spread over lanes, and a pixel's result depends
neither on its neighbours nor on the machine's registers. 1/√q is taken of q rounded to 24 bits, of which even
simple processors divide and root many at a time; one cubic correction (Householder's of third order) makes the 6e-8 of it
1e-21.
"""

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from uplift.spectrum import Float64

# Registers of 512 bits hold eight; with those of 256 bits, eight were faster than four too, though the sums overflow them.
LANES = 8
TERMS = 10  # numbers a wavelength: t, three weights, and these times t², and times t
C0, C1, C2, G0, G1, G2, ERROR = range(7)  # rows of the state of a run of pixels
_LARGEST = 1e36  # of q: float32 ends at 3e38. From |x| = 1e18 on S overshoots, which no residual forgives


def terms_of(weights: Float64, t: Float64) -> Float64:
    """Return [(N + 1) · TERMS] of `weights` [3, N] and `t` [N] as `newton_lanes` reads them: half the weights, for the twice S
    that it sums. The last ones, zero, are read but not used.
    """
    half = 0.5 * weights
    rows = np.concatenate([t[None], half, half * t * t, half * t]).T
    return np.concatenate([rows.reshape(-1), np.zeros(TERMS)])


class _Lanes:
    """A vector of the code being generated, with the usual operators; a product may be fused with a sum."""

    def __init__(self, builder: ir.IRBuilder, value: ir.Value) -> None:
        self.builder, self.value = builder, value

    def __add__(self, other: _Lanes) -> _Lanes:
        return _Lanes(self.builder, self.builder.fadd(self.value, other.value, flags=("contract",)))

    def __sub__(self, other: _Lanes) -> _Lanes:
        return _Lanes(self.builder, self.builder.fsub(self.value, other.value, flags=("contract",)))

    def __mul__(self, other: _Lanes) -> _Lanes:
        return _Lanes(self.builder, self.builder.fmul(self.value, other.value, flags=("contract",)))

    def __truediv__(self, other: _Lanes) -> _Lanes:
        return _Lanes(self.builder, self.builder.fdiv(self.value, other.value))

    def at_most(self, other: _Lanes) -> _Lanes:
        less = self.builder.fcmp_ordered("<", self.value, other.value)
        return _Lanes(self.builder, self.builder.select(less, self.value, other.value))

    def at_least(self, other: _Lanes) -> _Lanes:
        more = self.builder.fcmp_ordered(">", self.value, other.value)
        return _Lanes(self.builder, self.builder.select(more, self.value, other.value))


def _near_root(q: _Lanes, single: ir.Type):  # type: ignore[no-untyped-def]
    """Return 1/√q in 24 bits, for q in 1 … 1e36."""
    builder = q.builder
    kind = ir.FunctionType(single, [single])
    root = cgutils.get_or_insert_function(builder.module, kind, f"llvm.sqrt.v{LANES}f32")
    near = builder.call(root, [builder.fptrunc(q.value, single)])
    return builder.fdiv(ir.Constant(single, [1.0] * LANES), near)


@intrinsic
def newton_lanes(_, terms, start, wavelengths, state, stride, slot):  # type: ignore[no-untyped-def]
    """Take a Newton step towards Σ weights · S = (g0, g1, g2) for the pixels slot … slot + LANES − 1 of `state`, whose
    rows (C0 to ERROR) are `stride` apart; write c0, c1, c2 and the largest of the residuals' magnitudes before it.

    `terms` holds, from `start` on, those of a light with so many `wavelengths`. For compiled code only.
    """

    def generate(context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        _, start_value, count, _, stride_value, slot_value = arguments
        lane, index = ir.IntType(32), start_value.type
        vector, single = ir.VectorType(ir.DoubleType(), LANES), ir.VectorType(ir.FloatType(), LANES)
        numbers = context.make_array(terms)(context, builder, arguments[0]).data
        rows = context.make_array(state)(context, builder, arguments[3]).data

        def constant(value: float) -> _Lanes:
            return _Lanes(builder, ir.Constant(vector, [value] * LANES))

        def place(row: int):  # type: ignore[no-untyped-def]
            offset = builder.add(builder.mul(stride_value, ir.Constant(index, row)), slot_value)
            return builder.bitcast(builder.gep(rows, [offset]), vector.as_pointer())

        def of_row(row: int) -> _Lanes:
            return _Lanes(builder, builder.load(place(row), align=8, typ=vector))

        def term(at: ir.Value, which: int) -> _Lanes:
            pointer = builder.gep(numbers, [builder.add(at, ir.Constant(index, which))])
            value = builder.insert_element(ir.Constant(vector, ir.Undefined), builder.load(pointer), lane(0))
            same = ir.Constant(ir.VectorType(lane, LANES), [0] * LANES)
            return _Lanes(builder, builder.shuffle_vector(value, ir.Constant(vector, ir.Undefined), same))

        def begun(at: ir.Value) -> tuple[ir.Value, ...]:
            t = term(at, 0)
            x = (c0 * t + c1) * t + c2
            q = (constant(1.0) + x * x).at_most(constant(_LARGEST))
            return x.value, q.value, _near_root(q, single)

        c0, c1, c2 = of_row(C0), of_row(C1), of_row(C2)
        beginning, before = begun(start_value), builder.block
        loop, after = builder.append_basic_block("wavelength"), builder.append_basic_block("step")
        builder.branch(loop)
        builder.position_at_end(loop)
        k = builder.phi(index)
        x, q, near = (_Lanes(builder, builder.phi(value.type)) for value in beginning)
        sums = [_Lanes(builder, builder.phi(vector)) for _ in range(12)]
        at = builder.add(start_value, builder.mul(k, ir.Constant(index, TERMS)))
        # A root and a division take so long that those of the next wavelength run beside the sums of this one.
        next_begun = begun(builder.add(at, ir.Constant(index, TERMS)))
        y = _Lanes(builder, builder.fpext(near.value, vector))
        e = constant(1.0) - (q * y) * y
        r = y + (y * e) * (constant(0.5) + constant(0.375) * e)
        s, d = constant(1.0) + x * r, (r * r) * r
        totals = [total + term(at, 1 + which) * s for which, total in enumerate(sums[:3])]
        # The derivatives by c0, then by c1, take weights times t² and t; those by c2 the weights themselves.
        totals += [total + term(at, 1 + (which + 3) % 9) * d for which, total in enumerate(sums[3:])]
        following = builder.add(k, ir.Constant(index, 1))
        zero = ir.Constant(vector, [0.0] * LANES)
        for phi, first, later in (
            (k, ir.Constant(index, 0), following),
            *zip((x.value, q.value, near.value), beginning, next_begun, strict=True),
            *((phi.value, zero, total.value) for phi, total in zip(sums, totals, strict=True)),
        ):
            phi.add_incoming(first, before)
            phi.add_incoming(later, loop)
        builder.cbranch(builder.icmp_unsigned("<", following, count), loop, after)
        builder.position_at_end(after)

        f0, f1, f2, a, d_, g, b, e, h, c, f, i = totals
        r0, r1, r2 = of_row(G0) - f0, of_row(G1) - f1, of_row(G2) - f2
        A, B, C = e * i - f * h, f * g - d_ * i, d_ * h - e * g
        inverse = constant(1.0) / (a * A + b * B + c * C)
        sizes = [residual.at_least(constant(0.0) - residual) for residual in (r0, r1, r2)]
        for row, value in (
            (C0, c0 + (A * r0 + (c * h - b * i) * r1 + (b * f - c * e) * r2) * inverse),
            (C1, c1 + (B * r0 + (a * i - c * g) * r1 + (c * d_ - a * f) * r2) * inverse),
            (C2, c2 + (C * r0 + (b * g - a * h) * r1 + (a * e - b * d_) * r2) * inverse),
            (ERROR, sizes[0].at_least(sizes[1]).at_least(sizes[2])),
        ):
            builder.store(value.value, place(row), align=8)
        return context.get_dummy_value()

    return types.void(terms, start, wavelengths, state, stride, slot), generate
