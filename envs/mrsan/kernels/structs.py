"""Named tuples that compiled code takes by reference.

Numba passes a tuple by copying every number of every array in it, hundreds for `mrsan.state.State`,
into each function that is called, and compiling that takes longer than compiling everything else.
From a `Struct` compiled functions read the same fields through one pointer.
"""

from __future__ import annotations

import ctypes
import hashlib
import struct
from collections.abc import Sequence
from functools import cache
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AttributeTemplate
from numba.extending import infer_getattr, lower_getattr_generic, models, register_model

_EMPTY = types.Tuple(())
_TYPES = {
    tuple: _EMPTY,  # settings that there are not
    bool: types.boolean,
    np.bool_: types.boolean,
    int: types.int64,
    np.int64: types.int64,
    float: types.float64,
    np.float32: types.float32,
    np.float64: types.float64,
}
# Formats of module `struct`: every number, pointer and length has a word of its own.
_FORMATS = {types.boolean: "?7x", types.int64: "q", types.float64: "d", types.float32: "f4x"}
_address, _buffer = ctypes.addressof, ctypes.c_char.from_buffer
_WORD = ir.IntType(64)
_BYTE_POINTER = ir.IntType(8).as_pointer()


class Struct:
    """Arrays and numbers as fields that compiled code reads.

    It refers to the arrays, so compiled code reads and writes them in place.
    """

    __slots__ = ("_content", "_memory", "address", "type")

    def __init__(self, names: Sequence[str], values: Sequence[Any]) -> None:
        """Refer to values.

        Args:
            names: of the fields.
            values: C-contiguous arrays, numbers, structs, and named tuples of them.

        Raises:
            TypeError: a value is none of these.
        """
        content = [by_reference(value) if isinstance(value, tuple) else value for value in values]
        kinds, words = [], []
        for value in content:
            kind, *numbers = _words_of(value)
            kinds.append(kind)
            words += numbers
        self.type, layout = _layout(tuple(names), tuple(kinds))
        self._content = content  # keeps alive what the memory points to
        self._memory = ctypes.create_string_buffer(layout.pack(*words))
        self.address = _address(self._memory)


class KeepsStruct:
    """Mixin of named tuples that are passed to kernels again and again: they keep their struct."""

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle and copy the fields only."""
        return type(self), tuple(self)  # type: ignore[arg-type]


def by_reference(values: tuple[Any, ...]) -> Struct | tuple[()]:
    """Return a named tuple as a struct; `()`, which stands for settings that there are not, as is.

    Raises:
        TypeError: the tuple is another one, or has a value that compiled code cannot read.
    """
    if not values:
        return ()
    if not hasattr(values, "_fields"):
        raise TypeError(f"{values!r:.60} is a tuple; kernels take only tuples with named fields")
    if not isinstance(values, KeepsStruct):
        return Struct(values._fields, values)
    if "_struct" not in vars(values):
        vars(values)["_struct"] = Struct(values._fields, values)
    return vars(values)["_struct"]


def _words_of(value: Any) -> tuple[Any, ...]:
    """Return the kind of a value, followed by its numbers in memory.

    The kind determines the type of the field: a type of Numba for structs, of Python for numbers,
    and `(dtype, dimensions, writeable)` for arrays. All but the first are hashed fast.
    """
    kind = type(value)
    if kind is np.ndarray:
        flags = value.flags
        if flags.carray and value.size:
            pointer = _address(_buffer(value))
        elif flags.c_contiguous and flags.aligned:
            pointer = value.ctypes.data
        else:
            raise TypeError(
                f"an array of shape {value.shape} has strides {value.strides}; it must be "
                "C-contiguous (numpy.ascontiguousarray)"
            )
        return (value.dtype, value.ndim, flags.writeable), pointer, *value.shape
    if kind is Struct:
        return value.type, value.address
    if kind is tuple:
        return (kind,)
    if kind not in _TYPES:
        raise TypeError(f"{value!r:.60} is a {kind.__name__}, which kernels do not take")
    return kind, value


@cache
def _layout(names: tuple[str, ...], kinds: tuple[Any, ...]) -> tuple[StructType, struct.Struct]:
    """Return the type and the memory layout of a struct with fields of some kinds."""
    fields, layout = {}, "="
    for name, kind in zip(names, kinds, strict=True):
        if isinstance(kind, tuple):
            dtype, ndim, writeable = kind
            field = types.Array(numba.from_dtype(dtype), ndim, "C", readonly=not writeable)
            layout += "q" * (1 + ndim)
        else:
            field = _TYPES.get(kind, kind)
            layout += "" if field == _EMPTY else _FORMATS.get(field, "q")
        fields[name] = field
    return StructType(fields), struct.Struct(layout)


class StructType(types.Type):
    """The type of a `Struct` in compiled code."""

    def __init__(self, fields: dict[str, types.Type]) -> None:
        """Set the types of the fields."""
        self.fields = fields
        digest = hashlib.sha256(repr(fields).encode()).hexdigest()
        super().__init__(f"Struct_{digest[:16]}")  # symbols contain it: short

    def word_of(self, name: str) -> int:
        """Return the number of the first word of a field in memory."""
        before = list(self.fields).index(name)
        return sum(_length(kind) for kind in list(self.fields.values())[:before])


def _length(kind: types.Type) -> int:
    """Return the number of words of a field."""
    if isinstance(kind, types.Array):
        return 1 + int(kind.ndim)
    return 0 if kind == _EMPTY else 1


@register_model(StructType)
class _StructModel(models.PrimitiveModel):
    def __init__(self, manager: Any, struct_type: StructType) -> None:
        super().__init__(manager, struct_type, _BYTE_POINTER)


@infer_getattr
class _StructFields(AttributeTemplate):
    key = StructType

    def generic_resolve(self, struct_type: StructType, name: str) -> Any:
        if name == "all_fields":
            return types.Tuple(tuple(struct_type.fields.values()))
        return struct_type.fields.get(name)


@lower_getattr_generic(StructType)
def _read_field(
    context: Any, builder: Any, struct_type: StructType, pointer: Any, name: str
) -> Any:
    if name == "all_fields":
        values = [
            _read_field(context, builder, struct_type, pointer, field)
            for field in struct_type.fields
        ]
        kind = types.Tuple(tuple(struct_type.fields.values()))
        return context.make_tuple(builder, kind, values)
    kind, word = struct_type.fields[name], struct_type.word_of(name)
    if kind == _EMPTY:
        return context.make_tuple(builder, kind, [])

    def read(index: int, llvm_type: Any) -> Any:
        position = ir.Constant(_WORD, 8 * (word + index))
        place = builder.bitcast(builder.gep(pointer, [position]), llvm_type.as_pointer())
        value = builder.load(place)
        # Fields do not change during a call, so the compiler need not read them again.
        value.set_metadata("invariant.load", builder.module.add_metadata([]))
        return value

    if isinstance(kind, types.Array):
        data = read(0, context.get_data_type(kind.dtype).as_pointer())
        shape = [read(1 + axis, _WORD) for axis in range(kind.ndim)]
        strides = [context.get_constant(types.intp, context.get_abi_sizeof(data.type.pointee))]
        for length in reversed(shape[1:]):
            strides.insert(0, builder.mul(strides[0], length))
        array = context.make_array(kind)(context, builder)
        numba.np.arrayobj.populate_array(
            array,
            data=data,
            shape=cgutils.pack_array(builder, shape, _WORD),
            strides=cgutils.pack_array(builder, strides, _WORD),
            itemsize=strides[-1],
            meminfo=None,
        )
        return array._getvalue()
    value = read(0, context.get_data_type(kind))
    return context.data_model_manager[kind].from_data(builder, value)
