"""Files of other programs and of laboratories: one module for each format, which writes and reads it."""

from datagen.formats.exports import export
from datagen.formats.imports import import_captures

__all__ = ["export", "import_captures"]
