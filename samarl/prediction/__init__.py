"""Training and evaluation of the predictor of people (`mrsan.prediction`)."""
