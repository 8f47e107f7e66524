"""What layers remember, whole or half as long as the numbers of the field."""

from __future__ import annotations

from typing import TYPE_CHECKING

from llvmlite import ir

if TYPE_CHECKING:
    from farhorizon.engine.rows.vectors import Vectors

_I64, _I32 = ir.IntType(64), ir.IntType(32)


class Remembered:
    """Numbers that layers remember.

    The half of a double is its first 32 bits, which have its whole range and six digits. What follows is not cut off
    but rounded up or down as if by chance: a number between two others becomes the upper one in as many steps as it is
    near to it. Rounded to the nearest, it would learn nothing of changes below its last digit, and under a load that
    lasts the layers would stop following the field.

    Parameters
    ----------
    vectors : Vectors
    kept : str
        "int32" for halves, else the type of the field.
    dithered : ir.Value
        What is added to the other half before it is dropped.
    """

    def __init__(self, vectors: Vectors, kept: str, dithered: ir.Value) -> None:
        self.vectors, self.half = vectors, kept == "int32"
        self.long, self.short = (ir.VectorType(one, vectors.lanes) for one in (_I64, _I32))
        if self.half:
            self.places = ir.Constant(self.long, [32] * vectors.lanes)
            self.raised = vectors.splat(dithered)

    def bytes(self, at: ir.Value) -> ir.Value:
        """Distance of what goes with numbers of the field so many bytes on."""
        return self.vectors.builder.lshr(at, _I64(1)) if self.half else at

    def load(self, address: ir.Value) -> ir.Value:
        """A vector of the field's precision."""
        builder, vectors = self.vectors.builder, self.vectors
        if not self.half:
            return vectors.load(address)
        found = builder.load(vectors.pointer(address, self.short))
        found.align = 4
        return builder.bitcast(builder.shl(builder.zext(found, self.long), self.places), vectors.type)

    def store(self, value: ir.Value, address: ir.Value) -> None:
        """Keep a vector."""
        builder, vectors = self.vectors.builder, self.vectors
        if not self.half:
            vectors.store(value, address)
            return
        bits = builder.lshr(builder.add(builder.bitcast(value, self.long), self.raised), self.places)
        builder.store(builder.trunc(bits, self.short), vectors.pointer(address, self.short)).align = 4
