"""Files of other programs and of laboratories as a dataset: `datagen import`."""

from datagen.importing.captures import import_captures

__all__ = ["import_captures"]
