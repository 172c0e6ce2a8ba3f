"""Meeting an accuracy target: samples where the variance is, until a bound on the error is met."""
