"""The paper the model starts from: its estimators as printed, its figures, and what of it holds."""

from pathlib import Path

from datagen.compiled import drop_stale_kernels

_HERE = Path(__file__).parent
drop_stale_kernels(_HERE, _HERE.parent / "transport")
