"""The errors of the ray tracer that are not the language's: each says what is wrong and what would be right."""

from __future__ import annotations


class SceneError(ValueError):
    """A scene, mesh, picture size or ray cannot be used as it is given."""
