"""How good predictions are, in the metrics that people report: `datagen score`."""

from datagen.scoring.scores import Scores, score

__all__ = ["Scores", "score"]
