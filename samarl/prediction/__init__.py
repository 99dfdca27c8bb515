"""Training and measuring the predictor of people that the simulator runs (`mrsan.prediction`)."""
