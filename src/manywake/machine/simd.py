"""The vector type of the kernels: `W` lanes, one flow in each, in one machine register (or a few).

A lane array is a NumPy array whose dtype is `lanes(W, number)`: the W doubles or singles of one row. The dtype carries
width and precision, so numba compiles a kernel once per dtype, and inside it `load` yields a value of LLVM type
`<W x double>` or `<W x float>`. (Byte strings stand for doubles and unicode strings for singles, and not a record of
numbers: numba names compiled code by its types, but a record by a number that differs from process to process, so that
cached kernels of two widths could be called for one another.) LLVM leaves an ordinary inner loop over lanes scalar;
this type leaves it no choice, nor that of contracting products and sums: a fused multiply-add happens where the kernel
says `fma` and nowhere else, so each lane sees the same rounding for every width and on every processor.
"""

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, register_model
from numba.np.arrayobj import make_array

WIDTHS = (8, 4, 1)
"""Lane counts the kernels are compiled for, each when first used: 8 carry the batch (a row of singles is one AVX
register), 1 one flow, and 4 the rest of a batch of 20 in two thirds of the time that 8 take."""

_CACHE_LINE = 64


def lanes(width: int, number: type = np.float64) -> np.dtype:
    """Return the dtype of one row of `width` lanes of float64 or float32."""
    return np.dtype(f"S{8 * width}" if number == np.float64 else f"U{width}")


def zeros(shape: tuple[int, ...], width: int, number: type = np.float64) -> np.ndarray:
    """Return a zeroed lane array of `shape` rows, aligned to the cache line so that no load straddles two."""
    size = int(np.prod(shape)) * lanes(width, number).itemsize
    raw = np.zeros(size + _CACHE_LINE, np.uint8)
    offset = -raw.ctypes.data % _CACHE_LINE
    return raw[offset : offset + size].view(lanes(width, number)).reshape(shape)


def numbers(array: np.ndarray) -> np.ndarray:
    """Return the lane array as plain numbers with the lane as last axis, sharing memory."""
    number: type = np.float64 if array.dtype.kind == "S" else np.float32
    return array.view(number).reshape(*array.shape, array.dtype.itemsize // np.dtype(number).itemsize)


def pairs(array: np.ndarray) -> np.ndarray:
    """Return a velocity (n, 2) of W lanes as (n, 1) of 2 W lanes, both components in one row, sharing memory."""
    number = np.float64 if array.dtype.kind == "S" else np.float32
    return array.view(lanes(2 * numbers(array).shape[-1], number))


class Vector(types.Type):
    """numba's name for `<width x double>` (64 bits) or `<width x float>` (32 bits)."""

    def __init__(self, width: int, bits: int):
        self.width, self.bits = width, bits
        super().__init__(name=f"Vector({width} x {bits})")

    @property
    def llvm(self) -> ir.VectorType:
        return ir.VectorType(ir.DoubleType() if self.bits == 64 else ir.FloatType(), self.width)


@register_model(Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, fe_type.llvm)


def _row(array_type) -> Vector:
    """Return the vector that a row of the lane array is."""
    if isinstance(array_type.dtype, types.CharSeq):
        return Vector(array_type.dtype.count // 8, 64)
    return Vector(array_type.dtype.count, 32)


def _pointer(context, builder, signature, args):
    """Return the address of the row that the first three arguments name; no wraparound, no bounds check."""
    array_type = signature.args[0]
    array = make_array(array_type)(context, builder, args[0])
    indices = [context.cast(builder, args[k], signature.args[k], types.intp) for k in (1, 2)]
    pointer = cgutils.get_item_pointer(context, builder, array_type, array, indices, wraparound=False)
    return builder.bitcast(pointer, _row(array_type).llvm.as_pointer())


@intrinsic
def load(typingctx, array, i, c):
    """Row (i, c) of a lane array, as a vector."""

    def codegen(context, builder, signature, args):
        return builder.load(_pointer(context, builder, signature, args), align=4)

    return _row(array)(array, i, c), codegen


@intrinsic
def store(typingctx, array, i, c, value):
    """Write a vector to row (i, c) of a lane array."""

    def codegen(context, builder, signature, args):
        builder.store(args[3], _pointer(context, builder, signature, args), align=4)
        return context.get_dummy_value()

    return types.void(array, i, c, value), codegen


def _shuffle(builder, a, b, lanes):
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(ir.IntType(32), len(lanes)), lanes))


def _as_vector(context, builder, value, value_type, vector: Vector):
    if isinstance(value_type, Vector):
        return value
    number = context.cast(builder, value, value_type, types.float64 if vector.bits == 64 else types.float32)
    one = builder.insert_element(ir.Constant(vector.llvm, ir.Undefined), number, ir.Constant(ir.IntType(32), 0))
    return _shuffle(builder, one, one, [0] * vector.width)


def _as_vectors(context, builder, signature, args) -> list:
    """Return the arguments, numbers among them in every lane of a vector like the last argument."""
    return [_as_vector(context, builder, *pair, signature.args[-1]) for pair in zip(args, signature.args, strict=True)]


@intrinsic
def splat(typingctx, number, like):
    """The number in every lane, as wide and precise as the lane array `like`."""
    vector = _row(like)

    def codegen(context, builder, signature, args):
        return _as_vector(context, builder, args[0], signature.args[0], vector)

    return vector(number, like), codegen


@intrinsic
def fma(typingctx, a, b, c):
    """A * b + c with one rounding; `a` may be a number."""

    def codegen(context, builder, signature, args):
        kind, name = ir.FunctionType(b.llvm, [b.llvm] * 3), f"llvm.fma.v{b.width}f{b.bits}"
        function = cgutils.get_or_insert_function(builder.module, kind, name)
        return builder.call(function, _as_vectors(context, builder, signature, args))

    return b(a, b, c), codegen


def _binary(operation: str, doc: str):
    def function(typingctx, a, b):
        def codegen(context, builder, signature, args):
            return getattr(builder, operation)(*_as_vectors(context, builder, signature, args))

        return b(a, b), codegen

    function.__doc__ = doc
    function.__name__ = operation
    return intrinsic(function)


add = _binary("fadd", "a + b; `a` may be a number.")
sub = _binary("fsub", "a - b; `a` may be a number.")
mul = _binary("fmul", "a * b; `a` may be a number.")


@intrinsic
def maximum(typingctx, a, b):
    """The larger of a and b, lane by lane; `a` may be a number. A NaN in `b` stays."""

    def codegen(context, builder, signature, args):
        left, right = _as_vectors(context, builder, signature, args)
        return builder.select(builder.fcmp_ordered(">", left, right), left, right)

    return b(a, b), codegen


@intrinsic
def double(typingctx, a):
    """The vector in doubles, exactly; of doubles, itself."""

    def codegen(context, builder, signature, args):
        return args[0] if a.bits == 64 else builder.fpext(args[0], signature.return_type.llvm)

    return Vector(a.width, 64)(a), codegen


@intrinsic
def rounded(typingctx, a, like):
    """The vector of doubles, rounded to the precision of the lane array `like`."""
    bits = _row(like).bits

    def codegen(context, builder, signature, args):
        return args[0] if bits == 64 else builder.fptrunc(args[0], signature.return_type.llvm)

    return Vector(a.width, bits)(a, like), codegen


@intrinsic
def join(typingctx, a, b):
    """The lanes of a, then those of b: a row of `pairs` from its two components."""

    def codegen(context, builder, signature, args):
        return _shuffle(builder, *args, list(range(2 * a.width)))

    return Vector(2 * a.width, a.bits)(a, b), codegen


def _half(first: int, doc: str):
    def function(typingctx, a):
        width = a.width // 2

        def codegen(context, builder, signature, args):
            return _shuffle(builder, args[0], args[0], list(range(first * width, (first + 1) * width)))

        return Vector(width, a.bits)(a), codegen

    function.__doc__ = doc
    function.__name__ = "half"
    return intrinsic(function)


low = _half(0, "The first half of the lanes: the first component of a row of `pairs`.")
high = _half(1, "The second half of the lanes: the second component of a row of `pairs`.")
