"""Scores of predictions, in the usual metrics: `datagen score`."""

from datagen.scoring.scores import Scores, score

__all__ = ["Scores", "score"]
