"""Rollouts, the training loop, checkpoints."""
