"""Errors that end a training run."""


class TrainingError(RuntimeError):
    """A training run cannot go on: a gradient is not finite, or one of its processes has ended."""
