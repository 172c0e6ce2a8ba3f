"""The paper the model starts from: its estimators as printed, its figures, and what of it holds."""
