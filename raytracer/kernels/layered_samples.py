"""The samples of layered depth cubes as a walk reads them: in binary32, or with depths of binary16.

Stage: kernel. A table gives where the samples of texels begin, the depth of a sample, and a `Sample` with its slope and
its triangle. Numbers of 16 bits are decoded by operations on integers, so every device has the same bits.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

import shpy as sh
from raytracer.layered import raster
from raytracer.layered.cube import LayeredCube
from raytracer.layered.halves import STEEPEST, HalfTables
from raytracer.layered.placed import PlacedCubes

_SIGN, _REST = 0x8000, 0x7FFF
_EXPONENT = (127 - 15) << 23
"""The difference between the biases of the exponents of binary32 and binary16, at its place."""


class Sample(NamedTuple):
    """A sample: its depth, how that changes by a texel along a row and a column, and the number of its triangle.

    The slope is None but for hit="plane". A kernel keeps those parts that a test reads.
    """

    depth: Any
    slope: Any
    number: Any


def sample_tables(cube: LayeredCube | PlacedCubes) -> SingleSamples | HalfSamples:
    """Return the tables of the samples of a cube, or of several."""
    return HalfSamples(cube) if cube.options["depths"] == "half" else SingleSamples(cube)


class SingleSamples:
    """Samples in binary32: a row for each, with bits of the depth, slopes for hit="plane", and the triangle."""

    def __init__(self, cube: LayeredCube | PlacedCubes) -> None:
        self.has_slopes = cube.options["hit"] == "plane"
        records = cube.records if cube.samples else np.zeros((1, 4 if self.has_slopes else 2), np.uint32)
        self.offsets = sh.Table(cube.offsets, sh.Attrib1i, "offsets", unique=False)
        self.samples = sh.Table(records, sh.Attrib4u if self.has_slopes else sh.Attrib2u, "samples", unique=False)

    def coding(self, frame: Any, axis: Any) -> None:
        """Return the identity: these depths need no decoding."""

    def offset(self, texel: Any) -> Any:
        """Return where the samples of a texel begin."""
        return self.offsets[texel]

    def depth(self, item: Any, coding: None) -> Any:
        """Return the depth of a sample."""
        sample: Any = self.samples[item]
        return sh.float_from_bits(sample.x)

    def sample(self, item: Any, coding: None) -> Sample:
        """Return a sample."""
        row: Any = self.samples[item]
        slope = sh.float_from_bits(row.yz) if self.has_slopes else None
        return Sample(sh.float_from_bits(row.x), slope, sh.Attrib1i(row.w if self.has_slopes else row.y))


class DepthCoding:
    """The numbers that decode the samples of an image: the middle of its depths, their unit, the slopes of code 1."""

    def __init__(self, frame: Any, axis: Any) -> None:
        low, high = (raster.turned(frame[k].xyz, axis)[2] for k in (raster.LOW, raster.HIGH))
        self.middle, self.unit = (low + high) * 0.5, (high - low) * 0.5
        across, down, _ = raster.turned(frame[raster.SIZE].xyz, axis)
        self.steps = sh.Attrib2f(across, down) / STEEPEST


class HalfSamples:
    """Samples whose depths are binary16; see `layered.halves`."""

    def __init__(self, cube: LayeredCube | PlacedCubes) -> None:
        tables = HalfTables.of(cube)
        triangles = tables.triangles if len(tables.triangles) else np.zeros(1, np.int32)
        self.depths = sh.Table(tables.depths, sh.Attrib1u, "depths", unique=False)
        self.slopes = None if tables.slopes is None else sh.Table(tables.slopes, sh.Attrib1u, "slopes", unique=False)
        self.triangles = sh.Table(triangles, sh.Attrib1i, "numbers", unique=False)
        self.bases = sh.Table(tables.offsets.bases, sh.Attrib1i, "bases", unique=False)
        self.starts = sh.Table(tables.offsets.starts, sh.Attrib1u, "starts", unique=False)
        self.shift = sh.Param(sh.Attrib1i, tables.offsets.shift, name="shift", title="")

    def coding(self, frame: Any, axis: Any) -> DepthCoding:
        """Return the decoder of an image's samples."""
        return DepthCoding(frame, axis)

    def offset(self, texel: Any) -> Any:
        """Return where the samples of a texel begin."""
        return self.bases[texel >> self.shift] + sh.Attrib1i(code_of(self.starts, texel))

    def depth(self, item: Any, coding: DepthCoding) -> Any:
        """Return the depth of a sample."""
        code = code_of(self.depths, item)
        bits = ((code & _SIGN) << 16) | (((code & _REST) << 13) + _EXPONENT)
        return sh.float_from_bits(bits) * coding.unit + coding.middle

    def sample(self, item: Any, coding: DepthCoding) -> Sample:
        """Return a sample."""
        slope = None
        if self.slopes is not None:
            code = code_of(self.slopes, item)
            slope = (sh.Attrib2f(sh.Attrib1f(code & 0xFF), sh.Attrib1f(code >> 8)) - STEEPEST) * coding.steps
        return Sample(self.depth(item, coding), slope, self.triangles[item])


def code_of(table: Any, item: Any) -> Any:
    """Return the 16 bits at a place of a table of pairs."""
    word: Any = table[item >> 1]
    return (word >> sh.Attrib1u((item & 1) << 4)) & 0xFFFF
