"""The types with a meaning: points, vectors, normals, colours and texture coordinates.

Stage: record. Kinds differ where a matrix or a difference of points is concerned; else they mix freely.
"""

from shpy.lang.values.value import Value


class Point1f(Value):
    """A position: one float."""

    __slots__ = ()


class Point2f(Value):
    """A position: two floats."""

    __slots__ = ()


class Point3f(Value):
    """A position: three floats."""

    __slots__ = ()


class Point4f(Value):
    """A position: four floats."""

    __slots__ = ()


class Point1d(Value):
    """A position: one binary64."""

    __slots__ = ()


class Point2d(Value):
    """A position: two binary64."""

    __slots__ = ()


class Point3d(Value):
    """A position: three binary64."""

    __slots__ = ()


class Point4d(Value):
    """A position: four binary64."""

    __slots__ = ()


class Point1h(Value):
    """A position: one binary16."""

    __slots__ = ()


class Point2h(Value):
    """A position: two binary16."""

    __slots__ = ()


class Point3h(Value):
    """A position: three binary16."""

    __slots__ = ()


class Point4h(Value):
    """A position: four binary16."""

    __slots__ = ()


class Vector1f(Value):
    """A direction with a length: one float."""

    __slots__ = ()


class Vector2f(Value):
    """A direction with a length: two floats."""

    __slots__ = ()


class Vector3f(Value):
    """A direction with a length: three floats."""

    __slots__ = ()


class Vector4f(Value):
    """A direction with a length: four floats."""

    __slots__ = ()


class Vector1d(Value):
    """A direction with a length: one binary64."""

    __slots__ = ()


class Vector2d(Value):
    """A direction with a length: two binary64."""

    __slots__ = ()


class Vector3d(Value):
    """A direction with a length: three binary64."""

    __slots__ = ()


class Vector4d(Value):
    """A direction with a length: four binary64."""

    __slots__ = ()


class Vector1h(Value):
    """A direction with a length: one binary16."""

    __slots__ = ()


class Vector2h(Value):
    """A direction with a length: two binary16."""

    __slots__ = ()


class Vector3h(Value):
    """A direction with a length: three binary16."""

    __slots__ = ()


class Vector4h(Value):
    """A direction with a length: four binary16."""

    __slots__ = ()


class Normal1f(Value):
    """A surface normal: one float."""

    __slots__ = ()


class Normal2f(Value):
    """A surface normal: two floats."""

    __slots__ = ()


class Normal3f(Value):
    """A surface normal: three floats."""

    __slots__ = ()


class Normal4f(Value):
    """A surface normal: four floats."""

    __slots__ = ()


class Normal1d(Value):
    """A surface normal: one binary64."""

    __slots__ = ()


class Normal2d(Value):
    """A surface normal: two binary64."""

    __slots__ = ()


class Normal3d(Value):
    """A surface normal: three binary64."""

    __slots__ = ()


class Normal4d(Value):
    """A surface normal: four binary64."""

    __slots__ = ()


class Normal1h(Value):
    """A surface normal: one binary16."""

    __slots__ = ()


class Normal2h(Value):
    """A surface normal: two binary16."""

    __slots__ = ()


class Normal3h(Value):
    """A surface normal: three binary16."""

    __slots__ = ()


class Normal4h(Value):
    """A surface normal: four binary16."""

    __slots__ = ()


class Color1f(Value):
    """A colour: one float."""

    __slots__ = ()


class Color2f(Value):
    """A colour: two floats."""

    __slots__ = ()


class Color3f(Value):
    """A colour: three floats."""

    __slots__ = ()


class Color4f(Value):
    """A colour: four floats."""

    __slots__ = ()


class Color1d(Value):
    """A colour: one binary64."""

    __slots__ = ()


class Color2d(Value):
    """A colour: two binary64."""

    __slots__ = ()


class Color3d(Value):
    """A colour: three binary64."""

    __slots__ = ()


class Color4d(Value):
    """A colour: four binary64."""

    __slots__ = ()


class Color1h(Value):
    """A colour: one binary16."""

    __slots__ = ()


class Color2h(Value):
    """A colour: two binary16."""

    __slots__ = ()


class Color3h(Value):
    """A colour: three binary16."""

    __slots__ = ()


class Color4h(Value):
    """A colour: four binary16."""

    __slots__ = ()


class TexCoord1f(Value):
    """Texture coordinates: one float."""

    __slots__ = ()


class TexCoord2f(Value):
    """Texture coordinates: two floats."""

    __slots__ = ()


class TexCoord3f(Value):
    """Texture coordinates: three floats."""

    __slots__ = ()


class TexCoord4f(Value):
    """Texture coordinates: four floats."""

    __slots__ = ()


class TexCoord1d(Value):
    """Texture coordinates: one binary64."""

    __slots__ = ()


class TexCoord2d(Value):
    """Texture coordinates: two binary64."""

    __slots__ = ()


class TexCoord3d(Value):
    """Texture coordinates: three binary64."""

    __slots__ = ()


class TexCoord4d(Value):
    """Texture coordinates: four binary64."""

    __slots__ = ()


class TexCoord1h(Value):
    """Texture coordinates: one binary16."""

    __slots__ = ()


class TexCoord2h(Value):
    """Texture coordinates: two binary16."""

    __slots__ = ()


class TexCoord3h(Value):
    """Texture coordinates: three binary16."""

    __slots__ = ()


class TexCoord4h(Value):
    """Texture coordinates: four binary16."""

    __slots__ = ()
