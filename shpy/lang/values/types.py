"""The types of the language: one class for each kind, size and base.

Stage: record. `Attrib` is data of any meaning; the other kinds differ where a matrix or a difference of points is
concerned. GLSL's vector names are aliases.
"""

from shpy.lang.values.kinds import (
    Color1d,
    Color1f,
    Color1h,
    Color2d,
    Color2f,
    Color2h,
    Color3d,
    Color3f,
    Color3h,
    Color4d,
    Color4f,
    Color4h,
    Normal1d,
    Normal1f,
    Normal1h,
    Normal2d,
    Normal2f,
    Normal2h,
    Normal3d,
    Normal3f,
    Normal3h,
    Normal4d,
    Normal4f,
    Normal4h,
    Point1d,
    Point1f,
    Point1h,
    Point2d,
    Point2f,
    Point2h,
    Point3d,
    Point3f,
    Point3h,
    Point4d,
    Point4f,
    Point4h,
    TexCoord1d,
    TexCoord1f,
    TexCoord1h,
    TexCoord2d,
    TexCoord2f,
    TexCoord2h,
    TexCoord3d,
    TexCoord3f,
    TexCoord3h,
    TexCoord4d,
    TexCoord4f,
    TexCoord4h,
    Vector1d,
    Vector1f,
    Vector1h,
    Vector2d,
    Vector2f,
    Vector2h,
    Vector3d,
    Vector3f,
    Vector3h,
    Vector4d,
    Vector4f,
    Vector4h,
)
from shpy.lang.values.value import Value


class Attrib1f(Value):
    """One float."""

    __slots__ = ()


class Attrib2f(Value):
    """Two floats."""

    __slots__ = ()


class Attrib3f(Value):
    """Three floats."""

    __slots__ = ()


class Attrib4f(Value):
    """Four floats."""

    __slots__ = ()


class Attrib1d(Value):
    """One binary64."""

    __slots__ = ()


class Attrib2d(Value):
    """Two binary64."""

    __slots__ = ()


class Attrib3d(Value):
    """Three binary64."""

    __slots__ = ()


class Attrib4d(Value):
    """Four binary64."""

    __slots__ = ()


class Attrib1h(Value):
    """One binary16."""

    __slots__ = ()


class Attrib2h(Value):
    """Two binary16."""

    __slots__ = ()


class Attrib3h(Value):
    """Three binary16."""

    __slots__ = ()


class Attrib4h(Value):
    """Four binary16."""

    __slots__ = ()


class Attrib1i(Value):
    """One int."""

    __slots__ = ()


class Attrib2i(Value):
    """Two ints."""

    __slots__ = ()


class Attrib3i(Value):
    """Three ints."""

    __slots__ = ()


class Attrib4i(Value):
    """Four ints."""

    __slots__ = ()


class Attrib1u(Value):
    """One unsigned int."""

    __slots__ = ()


class Attrib2u(Value):
    """Two unsigned ints."""

    __slots__ = ()


class Attrib3u(Value):
    """Three unsigned ints."""

    __slots__ = ()


class Attrib4u(Value):
    """Four unsigned ints."""

    __slots__ = ()


class Attrib1b(Value):
    """One bool."""

    __slots__ = ()


class Attrib2b(Value):
    """Two bools."""

    __slots__ = ()


class Attrib3b(Value):
    """Three bools."""

    __slots__ = ()


class Attrib4b(Value):
    """Four bools."""

    __slots__ = ()


vec2 = Attrib2f
ivec2 = Attrib2i
uvec2 = Attrib2u
bvec2 = Attrib2b
vec3 = Attrib3f
ivec3 = Attrib3i
uvec3 = Attrib3u
bvec3 = Attrib3b
vec4 = Attrib4f
ivec4 = Attrib4i
uvec4 = Attrib4u
bvec4 = Attrib4b

__all__ = [
    "Attrib1b",
    "Attrib1d",
    "Attrib1f",
    "Attrib1h",
    "Attrib1i",
    "Attrib1u",
    "Attrib2b",
    "Attrib2d",
    "Attrib2f",
    "Attrib2h",
    "Attrib2i",
    "Attrib2u",
    "Attrib3b",
    "Attrib3d",
    "Attrib3f",
    "Attrib3h",
    "Attrib3i",
    "Attrib3u",
    "Attrib4b",
    "Attrib4d",
    "Attrib4f",
    "Attrib4h",
    "Attrib4i",
    "Attrib4u",
    "Color1d",
    "Color1f",
    "Color1h",
    "Color2d",
    "Color2f",
    "Color2h",
    "Color3d",
    "Color3f",
    "Color3h",
    "Color4d",
    "Color4f",
    "Color4h",
    "Normal1d",
    "Normal1f",
    "Normal1h",
    "Normal2d",
    "Normal2f",
    "Normal2h",
    "Normal3d",
    "Normal3f",
    "Normal3h",
    "Normal4d",
    "Normal4f",
    "Normal4h",
    "Point1d",
    "Point1f",
    "Point1h",
    "Point2d",
    "Point2f",
    "Point2h",
    "Point3d",
    "Point3f",
    "Point3h",
    "Point4d",
    "Point4f",
    "Point4h",
    "TexCoord1d",
    "TexCoord1f",
    "TexCoord1h",
    "TexCoord2d",
    "TexCoord2f",
    "TexCoord2h",
    "TexCoord3d",
    "TexCoord3f",
    "TexCoord3h",
    "TexCoord4d",
    "TexCoord4f",
    "TexCoord4h",
    "Vector1d",
    "Vector1f",
    "Vector1h",
    "Vector2d",
    "Vector2f",
    "Vector2h",
    "Vector3d",
    "Vector3f",
    "Vector3h",
    "Vector4d",
    "Vector4f",
    "Vector4h",
    "bvec2",
    "bvec3",
    "bvec4",
    "ivec2",
    "ivec3",
    "ivec4",
    "uvec2",
    "uvec3",
    "uvec4",
    "vec2",
    "vec3",
    "vec4",
]
