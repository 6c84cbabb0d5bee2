"""The vector type of the kernels: `W` lanes, one flow in each, in one machine register (or a few).

A lane array is a NumPy array whose dtype is `lanes(W)`: 8 W bytes, the doubles of one row. The dtype carries the width,
so numba compiles a kernel once per width, and inside the kernel `load` yields a value of LLVM type `<W x double>`.
(Bytes and not a record of doubles: numba names compiled code by its types, and names a record by a number that differs
from process to process, so that cached kernels of two widths can get one name and be called for one another.)
LLVM leaves an ordinary inner loop over lanes scalar; this type does not leave it the choice, nor the choice of
contracting products and sums: a fused multiply-add happens where the kernel says `fma`, and nowhere else, so each
lane sees the same rounding for every width and on every processor.
"""

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.imputils import impl_ret_untracked
from numba.extending import intrinsic, models, register_model
from numba.np.arrayobj import make_array

WIDTHS = (8, 4, 1)
"""Lane counts the kernels are compiled for: 8 carries the batch, 4 and 1 its remainder and the single flow."""

_CACHE_LINE = 64


def lanes(width: int) -> np.dtype:
    """Return the dtype of one row of `width` lanes."""
    return np.dtype(f"S{8 * width}")


def zeros(shape: tuple[int, ...], width: int) -> np.ndarray:
    """Return a zeroed lane array of `shape` rows, aligned to the cache line so that no load straddles two."""
    dtype = lanes(width)
    size = int(np.prod(shape)) * dtype.itemsize
    raw = np.zeros(size + _CACHE_LINE, np.uint8)
    offset = -raw.ctypes.data % _CACHE_LINE
    return raw[offset : offset + size].view(dtype).reshape(shape)


def numbers(array: np.ndarray) -> np.ndarray:
    """Return the lane array as plain doubles with the lane as last axis, sharing memory."""
    return array.view(np.float64).reshape(*array.shape, -1)


class Vector(types.Type):
    """numba's name for `<width x double>`."""

    def __init__(self, width: int):
        self.width = width
        super().__init__(name=f"Vector({width})")


@register_model(Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, ir.VectorType(ir.DoubleType(), fe_type.width))


def _width(array_type) -> int:
    return array_type.dtype.count // 8


def _pointer(context, builder, array_type, array, indices):
    """Return the address of a row; no wraparound, no bounds check."""
    array = make_array(array_type)(context, builder, array)
    indices = [context.cast(builder, value, t, types.intp) for value, t in indices]
    pointer = cgutils.get_item_pointer(context, builder, array_type, array, indices, wraparound=False)
    vector = ir.VectorType(ir.DoubleType(), _width(array_type))
    return builder.bitcast(pointer, vector.as_pointer()), vector


@intrinsic
def load(typingctx, array, i, c):
    """Row (i, c) of a lane array, as a vector."""

    def codegen(context, builder, signature, args):
        index = [(args[1], signature.args[1]), (args[2], signature.args[2])]
        pointer, _ = _pointer(context, builder, signature.args[0], args[0], index)
        return builder.load(pointer, align=8)

    return Vector(_width(array))(array, i, c), codegen


@intrinsic
def store(typingctx, array, i, c, value):
    """Write a vector to row (i, c) of a lane array."""

    def codegen(context, builder, signature, args):
        index = [(args[1], signature.args[1]), (args[2], signature.args[2])]
        pointer, _ = _pointer(context, builder, signature.args[0], args[0], index)
        builder.store(args[3], pointer, align=8)
        return context.get_dummy_value()

    return types.void(array, i, c, value), codegen


def _splat(builder, scalar, width):
    vector = ir.VectorType(ir.DoubleType(), width)
    one = builder.insert_element(ir.Constant(vector, ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0))
    mask = ir.Constant(ir.VectorType(ir.IntType(32), width), [0] * width)
    return builder.shuffle_vector(one, ir.Constant(vector, ir.Undefined), mask)


def _as_vector(context, builder, value, value_type, width):
    if isinstance(value_type, Vector):
        return value
    return _splat(builder, context.cast(builder, value, value_type, types.float64), width)


@intrinsic
def splat(typingctx, number, like):
    """The number in every lane, as wide as the lane array `like`."""
    width = _width(like)

    def codegen(context, builder, signature, args):
        return _as_vector(context, builder, args[0], signature.args[0], width)

    return Vector(width)(number, like), codegen


@intrinsic
def fma(typingctx, a, b, c):
    """A * b + c with one rounding; `a` may be a number."""
    width = b.width

    def codegen(context, builder, signature, args):
        vector = ir.VectorType(ir.DoubleType(), width)
        function = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(vector, [vector] * 3), f"llvm.fma.v{width}f64"
        )
        values = [_as_vector(context, builder, value, t, width) for value, t in zip(args, signature.args, strict=True)]
        result = builder.call(function, values)
        return impl_ret_untracked(context, builder, signature.return_type, result)

    return Vector(width)(a, b, c), codegen


def _binary(operation: str, doc: str):
    def function(typingctx, a, b):
        width = b.width

        def codegen(context, builder, signature, args):
            values = [
                _as_vector(context, builder, value, t, width) for value, t in zip(args, signature.args, strict=True)
            ]
            return getattr(builder, operation)(*values)

        return Vector(width)(a, b), codegen

    function.__doc__ = doc
    function.__name__ = operation
    return intrinsic(function)


add = _binary("fadd", "a + b; `a` may be a number.")
sub = _binary("fsub", "a - b; `a` may be a number.")
mul = _binary("fmul", "a * b; `a` may be a number.")


@intrinsic
def maximum(typingctx, a, b):
    """The larger of a and b, lane by lane; `a` may be a number. A NaN in `b` stays."""
    width = b.width

    def codegen(context, builder, signature, args):
        left, right = (
            _as_vector(context, builder, value, t, width) for value, t in zip(args, signature.args, strict=True)
        )
        return builder.select(builder.fcmp_ordered(">", left, right), left, right)

    return Vector(width)(a, b), codegen
