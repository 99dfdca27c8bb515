"""What has parameters and drives."""
